/**
 * What a notebook shows of a session: its mesh, to be looked at from all sides, and a dot for each handle, to be dragged.
 *
 * Plain WebGL 2: nothing is loaded from elsewhere. Requests go to Python one at a time; while one waits for its answer, only the newest pose
 * of a drag waits behind it.
 */

const VERTEX_SHADER = `#version 300 es
in vec3 position, normal;
uniform mat4 clipFromModel;
out vec3 place, smoothNormal;
void main() {
  place = position;
  smoothNormal = normal;
  gl_Position = clipFromModel * vec4(position, 1);
  gl_PointSize = 3.0;
}`;

// Where smooth normals are far from the triangle's own, there is an edge. Both sides are lit: open surfaces have no inside.
const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec3 place, smoothNormal;
uniform vec3 eye, light;
uniform bool isPoints;
out vec4 color;
void main() {
  vec3 toEye = normalize(eye - place), normal = toEye;
  if (!isPoints) {
    vec3 flatNormal = normalize(cross(dFdx(place), dFdy(place)));
    flatNormal *= sign(dot(flatNormal, toEye));
    normal = normalize(smoothNormal);
    normal *= sign(dot(normal, flatNormal));
    normal = normalize(mix(flatNormal, normal, smoothstep(0.75, 0.9, dot(normal, flatNormal))));
  }
  float lit = 0.3 + 0.55 * max(dot(normal, light), 0.0) + 0.15 * max(dot(normal, toEye), 0.0);
  color = vec4(vec3(0.72, 0.75, 0.8) * lit, 1);
}`;

/** The tangent of half the angle that a view is high. */
const HALF_VIEW = Math.tan(0.3);
/** Milliseconds after which a request that waits is spoken of. */
const LATE_MS = 1000;

const plus = (a, b, factor = 1) => a.map((value, k) => value + factor * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** Numbers that came as bytes at any place. */
function numbers(Type, { buffer, byteOffset, byteLength }) {
  return new Type(buffer.slice(byteOffset, byteOffset + byteLength));
}

/** Normals that vertices at the same place share. */
function smoothNormals(positions, triangles, welded) {
  const sums = new Float32Array(positions.length);
  for (let k = 0; k < triangles.length; k += 3) {
    const [a, b, c] = [3 * triangles[k], 3 * triangles[k + 1], 3 * triangles[k + 2]];
    const [ux, uy, uz] = [positions[b] - positions[a], positions[b + 1] - positions[a + 1], positions[b + 2] - positions[a + 2]];
    const [vx, vy, vz] = [positions[c] - positions[a], positions[c + 1] - positions[a + 1], positions[c + 2] - positions[a + 2]];
    for (let corner = k; corner < k + 3; corner++) {
      const at = 3 * welded[triangles[corner]];
      sums[at] += uy * vz - uz * vy;
      sums[at + 1] += uz * vx - ux * vz;
      sums[at + 2] += ux * vy - uy * vx;
    }
  }
  return sums.map((_, k) => sums[3 * welded[Math.floor(k / 3)] + (k % 3)]);
}

/** What is drawn: buffers of the graphics card. */
class Surface {
  constructor(canvas) {
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: true }));
    if (gl === null) throw new Error("this browser has no WebGL 2, so the mesh cannot be drawn");
    const program = (this.program = gl.createProgram());
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    this.buffers = ["position", "normal"].map((name) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      const at = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
      return buffer;
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  }

  connect(triangles, welded) {
    [this.triangles, this.welded] = [triangles, welded];
    this.gl.bufferData(this.gl.ELEMENT_ARRAY_BUFFER, triangles, this.gl.STATIC_DRAW);
  }

  place(positions) {
    this.count = positions.length / 3;
    [positions, smoothNormals(positions, this.triangles, this.welded)].forEach((values, k) => {
      this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffers[k]);
      this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.DYNAMIC_DRAW);
    });
  }

  draw({ clipFromModel, eye, light }) {
    const { gl, program } = this;
    const at = (name) => gl.getUniformLocation(program, name);
    gl.viewport(0, 0, gl.canvas.width, gl.canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(at("clipFromModel"), false, clipFromModel);
    gl.uniform3fv(at("eye"), eye);
    gl.uniform3fv(at("light"), light);
    gl.uniform1i(at("isPoints"), this.triangles.length === 0);
    if (this.triangles.length > 0) gl.drawElements(gl.TRIANGLES, this.triangles.length, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(gl.POINTS, 0, this.count);
  }
}

/** From where the mesh is seen: it goes around a center. */
class Camera {
  /** Shows all of it. */
  frame(positions) {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    positions.forEach((value, k) => {
      low[k % 3] = Math.min(low[k % 3], value);
      high[k % 3] = Math.max(high[k % 3], value);
    });
    this.center = low.map((value, k) => (value + high[k]) / 2);
    this.radius = Math.hypot(...plus(high, low, -1)) / 2 || 1;
    this.distance = (0.85 * this.radius) / Math.sin(Math.atan(HALF_VIEW));
    [this.yaw, this.pitch] = [0.42, 0.26];
  }

  look(width, height) {
    const { yaw, pitch, distance, center, radius } = this;
    const back = [Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)];
    const right = [Math.cos(yaw), 0, -Math.sin(yaw)];
    const up = cross(back, right);
    const eye = plus(center, back, distance);
    const [near, far] = [Math.max(distance - 4 * radius, distance / 100), distance + 4 * radius];
    const scaled = (axis, factor) => axis.map((v) => v * factor);
    const across = scaled(right, height / (HALF_VIEW * width));
    const rows = [across, scaled(up, 1 / HALF_VIEW), scaled(back, (far + near) / (near - far)), scaled(back, -1)];
    const last = [0, 0, (-2 * far * near) / (far - near), 0];
    const clipFromModel = [0, 1, 2].flatMap((k) => rows.map((row) => row[k])).concat(rows.map((row, k) => last[k] - dot(row, eye)));
    /** Pixels from the left and from the top, and model units per pixel there. */
    const onScreen = (point) => {
      const away = plus(point, eye, -1);
      const depth = -dot(away, back);
      const unit = (2 * HALF_VIEW * depth) / height;
      return { x: width / 2 + dot(away, right) / unit, y: height / 2 - dot(away, up) / unit, unit, isBefore: depth > near };
    };
    const light = plus(plus(scaled(back, 0.75), up, 0.55), right, 0.37);
    return { clipFromModel, eye, light, right, up, onScreen };
  }
}

function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "pliant";
  root.style.height = `${model.get("height")}px`;
  root.innerHTML = `<canvas></canvas><p role="status"></p><p role="alert" hidden></p><div>
    <button title="Take back the last change">Undo</button>
    <button title="Repeat what was undone">Redo</button>
    <button title="Show all of the mesh">Frame</button></div>`;
  root.title = "Drag a dot to move its handle; with Shift, to turn it. Drag beside them to orbit, with Shift to pan; the wheel zooms.";
  el.append(root);
  const [canvas, status, alert] = root.children;
  const say = (error) => ([alert.textContent, alert.hidden] = [error, error === ""]);
  const camera = new Camera();
  const view = crypto.getRandomValues(new Uint32Array(2)).join("-");
  let surface, positions, sight, drag;
  const dots = new Map();
  let drawing = 0;

  // One request is on its way; the others wait in order, of the poses of a drag the newest.
  const queue = [];
  let late;
  function ask(request) {
    const before = queue.at(-1);
    if (before?.kind === "drag" && !before.end && queue.length > 1) queue.pop();
    if (queue.push({ ...request, view }) === 1) send();
  }
  function send() {
    late = setTimeout(() => (status.textContent = "waiting for Python, which may be running a cell"), LATE_MS);
    model.send(queue[0]);
  }
  function answered(answer, buffers) {
    const isFrame = buffers?.length > 0;
    if (isFrame) show(numbers(Float32Array, buffers[0]));
    if (answer.view !== view) return;
    clearTimeout(late);
    queue.shift();
    if (answer.error !== "") {
      // What waits belongs to a drag that is over.
      queue.length = 0;
      drag = undefined;
    }
    // A drag is over that no frame follows: what is committed is shown, also where that did not change.
    if (!isFrame) load();
    describe();
    say(answer.error);
    if (queue.length > 0) send();
  }

  function draw() {
    drawing = 0;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (surface === undefined || width === 0) return;
    [canvas.width, canvas.height] = [width, height].map((size) => Math.round(size * devicePixelRatio));
    sight = camera.look(width, height);
    surface.draw(sight);
    for (const [id, { element, place }] of dots) {
      const moved = drag?.id === id && drag.by ? plus(place, drag.by) : place;
      const { x, y, isBefore } = sight.onScreen(moved);
      element.hidden = !isBefore;
      element.style.transform = `translate(${x}px, ${y}px)`;
      element.classList.toggle("held", drag?.id === id);
    }
  }
  const redraw = () => (drawing ||= requestAnimationFrame(draw));
  const describe = () => (status.textContent = model.get("status"));

  function show(newer) {
    positions = newer;
    surface.place(positions);
    redraw();
  }
  function load() {
    surface.connect(numbers(Uint32Array, model.get("triangles")), numbers(Uint32Array, model.get("welded")));
    show(numbers(Float32Array, model.get("positions")));
    describe();
  }
  function place() {
    const places = new Map(model.get("handles").map(({ id, place }) => [id, place]));
    for (const [id, { element }] of dots) if (!places.has(id)) [element.remove(), dots.delete(id)];
    // Those that stay are the same elements: one of them may be under the pointer.
    for (const [id, place] of places) dots.set(id, { place, element: dots.get(id)?.element ?? dotOf(id) });
    redraw();
  }

  function dotOf(id) {
    const dot = document.createElement("button");
    dot.className = "handle";
    dot.append(Object.assign(document.createElement("span"), { textContent: id }));
    dot.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      dot.setPointerCapture(event.pointerId);
      const { unit } = sight.onScreen(dots.get(id).place);
      drag = { id, x: event.clientX, y: event.clientY, unit, isTurn: event.shiftKey, isMoved: false };
      redraw();
    });
    dot.addEventListener("pointermove", (event) => {
      if (drag?.id !== id) return;
      const [right, down] = [event.clientX - drag.x, event.clientY - drag.y];
      if (!drag.isMoved && Math.hypot(right, down) < 3) return;
      drag.isMoved = true;
      const across = (r, u) => plus(sight.right.map((v) => v * r), sight.up, u);
      if (drag.isTurn) drag.turn = across(0.01 * down, 0.01 * right);
      else drag.by = across(right * drag.unit, -down * drag.unit);
      ask(request(false));
      redraw();
    });
    dot.addEventListener("pointerup", () => release(id, false));
    dot.addEventListener("pointercancel", () => release(id, true));
    dot.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      event.stopPropagation();
      release(id, true);
    });
    root.append(dot);
    return dot;
  }
  const request = (end) => ({ kind: "drag", id: drag.id, by: drag.by ?? [0, 0, 0], turn: drag.turn ?? [0, 0, 0], end });
  function release(id, isCancelled) {
    if (drag?.id !== id) return;
    if (drag.isMoved) {
      ask({ ...request(true), cancel: isCancelled });
      // The dot stays where it was left until its handle is there.
      const dot = dots.get(id);
      if (!isCancelled && drag.by) dot.place = plus(dot.place, drag.by);
    }
    drag = undefined;
    redraw();
  }

  canvas.addEventListener("pointerdown", ({ pointerId }) => canvas.setPointerCapture(pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons === 0 || sight === undefined) return;
    if (event.shiftKey || event.buttons > 1) {
      const { unit } = sight.onScreen(camera.center);
      camera.center = plus(plus(camera.center, sight.right, -event.movementX * unit), sight.up, event.movementY * unit);
    } else {
      camera.yaw -= 0.01 * event.movementX;
      camera.pitch = Math.max(-1.55, Math.min(1.55, camera.pitch + 0.01 * event.movementY));
    }
    redraw();
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  const zoom = (event) => {
    event.preventDefault();
    camera.distance = Math.max(camera.radius / 100, Math.min(camera.radius * 100, camera.distance * Math.exp(0.001 * event.deltaY)));
    redraw();
  };
  root.addEventListener("wheel", zoom, { passive: false });
  const [undo, redo, frame] = root.querySelectorAll("div > button");
  undo.onclick = () => ask({ kind: "undo" });
  redo.onclick = () => ask({ kind: "redo" });
  frame.onclick = () => [camera.frame(positions), redraw()];

  try {
    surface = new Surface(canvas);
    load();
    camera.frame(positions);
    place();
  } catch (error) {
    say(error.message);
    return;
  }
  const heard = { "msg:custom": answered, "change:positions": load, "change:triangles": load, "change:handles": place, "change:status": describe };
  for (const [event, hear] of Object.entries(heard)) model.on(event, hear);
  const sizes = new ResizeObserver(redraw);
  sizes.observe(root);
  return () => {
    for (const [event, hear] of Object.entries(heard)) model.off(event, hear);
    sizes.disconnect();
    clearTimeout(late);
    surface.gl.getExtension("WEBGL_lose_context")?.loseContext();
  };
}

export default { render };

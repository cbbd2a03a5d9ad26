import { Client } from "pliant-client";
import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { TransformControls } from "three/addons/controls/TransformControls.js";

const [canvas, status] = ["canvas", "p"].map((name) => document.querySelector(name));
const server = new URLSearchParams(location.search).get("server") ?? "http://127.0.0.1:7411";
const fail = (error) => {
  status.textContent = error.message; // for example: no server answers
  throw error;
};
const session = await new Client({ url: server }).sample().catch(fail); // or open(file) with a dropped or picked File
const head = { center: [0.76, 1.22, 0], radius: 0.36 };
await session.setHandles({
  handles: [
    { id: "feet", region: { halfSpace: { normal: [0, -1, 0], offset: -0.14 } } },
    { id: "head", region: { sphere: head } },
  ],
});

// Frames go straight into the vertex buffer.
const { positions, indices } = await session.topology();
const geometry = new three.BufferGeometry();
const position = new three.BufferAttribute(positions, 3).setUsage(three.DynamicDrawUsage);
geometry.setAttribute("position", position);
geometry.setIndex(new three.BufferAttribute(indices, 1));
geometry.computeVertexNormals();
geometry.computeBoundingSphere();
const { center, radius } = geometry.boundingSphere;
const creature = new three.Mesh(geometry, new three.MeshStandardMaterial({ color: 0x8899cc }));
creature.frustumCulled = false; // its bounds change with every frame

const scene = new three.Scene();
scene.background = new three.Color(0xf4f4f0);
const camera = new three.PerspectiveCamera(40, canvas.width / canvas.height, radius / 100, radius * 100);
camera.position.set(center.x + radius, center.y + radius * 0.6, center.z + radius * 3);
const renderer = new three.WebGLRenderer({ canvas, antialias: true });
const orbit = new OrbitControls(camera, canvas);
orbit.target.copy(center);

// The user moves the grip. Its motion since the start is the pose of the handle.
const rest = new three.Vector3(...head.center);
const grip = new three.Object3D();
grip.position.copy(rest);
const arrows = new TransformControls(camera, canvas);
arrows.attach(grip);
scene.add(creature, grip, arrows.getHelper(), new three.HemisphereLight(0xffffff, 0x777766, 3));

const pose = () => [
  {
    id: "head",
    pose: { translation: grip.position.clone().sub(rest).toArray(), rotation: grip.quaternion.toArray(), pivot: head.center },
  },
];
const stream = session.stream({ tolerance: 1e-4 }, { onPoseError: (error) => (status.textContent = error.message) });
let waiting; // the newest pose, not sent yet
arrows.addEventListener("objectChange", () => (waiting = pose()));
arrows.addEventListener("dragging-changed", async ({ value: isDragging }) => {
  orbit.enabled = !isDragging;
  if (isDragging) return;
  waiting = undefined; // the commit contains the same pose
  const kept = await stream.commit(pose()).catch(fail); // recorded, refined, and one step for undo
  document.title = `Revision ${kept.revision}`;
});
addEventListener("keydown", ({ key }) => arrows.setMode({ e: "rotate", w: "translate" }[key] ?? arrows.mode));

/** Runs once per animation frame: sends the newest pose, takes the newest shape. */
renderer.setAnimationLoop(() => {
  if (waiting) stream.pose(waiting);
  waiting = undefined;
  const frame = stream.take(position.array);
  if (frame) {
    position.needsUpdate = true;
    geometry.computeVertexNormals();
    status.textContent = `${frame.solveMs.toFixed(1)} ms`;
  }
  orbit.update();
  renderer.render(scene, camera);
});

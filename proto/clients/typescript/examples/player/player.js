import { Client } from "pliant-client";
import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const [canvas, slider, status] = ["canvas", "input", "output"].map((name) => document.querySelector(name));
const server = new URLSearchParams(location.search).get("server") ?? "http://127.0.0.1:7411";
const pliant = new Client({ url: server });
const fail = (error) => {
  status.textContent = error.message; // for example: no server answers
  throw error;
};
const session = await pliant.sample({ name: "figure" }).catch(fail); // or pliant.open(file) with a dropped or picked File

// The page shows the first primitive.
const { positions, normals, indices } = await session.topology();
const geometry = new three.BufferGeometry();
geometry.setAttribute("position", new three.BufferAttribute(positions, 3));
if (normals) geometry.setAttribute("normal", new three.BufferAttribute(normals, 3));
geometry.setIndex(new three.BufferAttribute(indices, 1));
geometry.setDrawRange(0, session.facts.primitives[0].indexCount);
const position = geometry.getAttribute("position");
geometry.computeBoundingSphere();
const { center, radius } = geometry.boundingSphere;
const figureMesh = new three.Mesh(geometry, new three.MeshStandardMaterial({ color: 0x8899cc, side: three.DoubleSide }));
figureMesh.frustumCulled = false;

const scene = new three.Scene();
scene.background = new three.Color(0xf4f4f0);
scene.add(figureMesh, new three.HemisphereLight(0xffffff, 0x777766, 3));
const camera = new three.PerspectiveCamera(40, canvas.width / canvas.height, radius / 100, radius * 100);
camera.position.set(center.x + radius * 2, center.y + radius * 0.5, center.z + radius * 3);
const controls = new OrbitControls(camera, canvas);
controls.target.copy(center);
const renderer = new three.WebGLRenderer({ canvas, antialias: true });

// The page stores each frame, so the slider can go back.
const frames = [];
let seconds = 0;

function show(frame) {
  if (frame === undefined) return;
  position.array.set(frame.positions);
  position.needsUpdate = true;
  geometry.computeVertexNormals();
  figureMesh.position.fromArray(frame.rootTranslation);
  figureMesh.quaternion.fromArray(frame.rootRotation);
}

let before = performance.now();
renderer.setAnimationLoop((now) => {
  const last = frames.at(-1)?.time ?? 0;
  seconds = document.activeElement === slider ? Number(slider.value) : (seconds + (now - before) / 1000) % (last || 1);
  before = now;
  slider.value = seconds;
  show(frames.findLast(({ time }) => time <= seconds) ?? frames[0]);
  controls.update();
  renderer.render(scene, camera);
});

const walk = session.animate({ clip: "walk", fps: 30, output: { encoding: "U16" } });
async function keep() {
  for await (const { frame, ...facts } of walk) {
    const positions = new Float32Array(position.array.length);
    frame.positionsInto(positions);
    frames.push({ ...facts, positions });
    slider.max = facts.time;
    slider.step = "any";
    status.textContent = `${facts.index + 1} of ${facts.count} frames`;
  }
}
await keep().catch(fail);
status.textContent = `${frames.length} frames, ${walk.report.totals.framesPerSecond.toFixed(1)} a second`;

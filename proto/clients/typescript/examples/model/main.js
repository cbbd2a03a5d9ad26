import { Client } from "pliant-client";
import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { shown } from "./shown.js";

const [canvas, status] = ["canvas", "p"].map((name) => document.querySelector(name));
const server = new URLSearchParams(location.search).get("server") ?? "http://127.0.0.1:7411";
const fail = (error) => {
  status.textContent = error.message; // for example: no server answers
  throw error;
};
const session = await new Client({ url: server }).sample().catch(fail); // or open(file) with a dropped or picked File
const model = await shown(session).catch(fail);

const renderer = new three.WebGLRenderer({ canvas, antialias: true });
const scene = new three.Scene();
scene.background = new three.Color(0xf4f4f0);
// glTF's default material is a metal: it is black without surroundings.
scene.environment = new three.PMREMGenerator(renderer).fromScene(new RoomEnvironment()).texture;
scene.environmentIntensity = 0.3;
scene.add(model);

const { center, radius } = new three.Box3().setFromObject(model).getBoundingSphere(new three.Sphere());
const camera = new three.PerspectiveCamera(40, canvas.width / canvas.height, radius / 100, radius * 100);
camera.position.set(center.x + radius, center.y + radius * 0.6, center.z + radius * 3);
const orbit = new OrbitControls(camera, canvas);
orbit.target.copy(center);

renderer.setAnimationLoop(() => {
  orbit.update();
  renderer.render(scene, camera);
});
status.textContent = "Drag to look around.";

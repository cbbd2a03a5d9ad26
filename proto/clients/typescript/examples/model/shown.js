import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

/** The session's model in its current shape, as an object for a scene. */
export async function shown(session) {
  const glb = await session.model("glb"); // GET /v1/sessions/ID/model?format=glb
  const { scene } = await new GLTFLoader().parseAsync(await glb.arrayBuffer(), "");
  scene.traverse(({ isMesh, geometry, material }) => {
    if (!isMesh || geometry.getAttribute("normal")) return;
    geometry.computeVertexNormals(); // the source had none
    material.flatShading = false;
  });
  return scene;
}

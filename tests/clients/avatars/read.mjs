// Reads avatars with three-vrm, as web pages do, and prints what they find: where bones and colliders are, how far eyes are from the head.
globalThis.self = globalThis;
globalThis.ProgressEvent ??= class extends Event {};
const { readFile } = await import("node:fs/promises");
const { Vector3 } = await import("three");
const { GLTFLoader } = await import("three/examples/jsm/loaders/GLTFLoader.js");
const { VRMLoaderPlugin } = await import("@pixiv/three-vrm");
const place = (object) => object.getWorldPosition(new Vector3()).toArray();
const found = [];
for (const path of process.argv.slice(2)) {
  const bytes = await readFile(path);
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMLoaderPlugin(parser));
  const gltf = await loader.parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength), "");
  const vrm = gltf.userData.vrm;
  gltf.scene.updateWorldMatrix(true, true);
  const springs = vrm.springBoneManager;
  found.push({
    version: vrm.meta.metaVersion,
    bones: Object.fromEntries(Object.entries(vrm.humanoid.rawHumanBones).map(([name, bone]) => [name, place(bone.node)])),
    expressions: vrm.expressionManager?.expressions.map((e) => e.expressionName) ?? [],
    eyes: vrm.lookAt?.offsetFromHeadBone.toArray(),
    colliders: springs?.colliders.map((c) => ({ at: place(c), offset: c.shape.offset?.toArray(), radius: c.shape.radius })) ?? [],
    springs: springs === undefined ? 0 : springs.joints.size,
  });
}
console.log(JSON.stringify(found));

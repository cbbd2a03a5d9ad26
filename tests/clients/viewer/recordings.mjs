/** Recordings and rigs for the scenes, made of numbers. */

/** An upright body in centimetres, each joint with the ones that hang on it and its offset. */
const BODY = ["Hips", [0, 95, 0], [
  ["Spine", [0, 30, 0], [
    ["Head", [0, 30, 0], []],
    ["LeftArm", [18, 15, 0], [["LeftForeArm", [27, 0, 0], [["LeftHand", [25, 0, 0], []]]]]],
    ["RightArm", [-18, 15, 0], [["RightForeArm", [-27, 0, 0], [["RightHand", [-25, 0, 0], []]]]]],
  ]],
  ["LeftUpLeg", [9, -5, 0], [["LeftLeg", [0, -42, 0], []]]],
  ["RightUpLeg", [-9, -5, 0], [["RightLeg", [0, -42, 0], []]]],
]];
/** Joints that turn. */
const TURNING = ["Spine", "LeftArm", "LeftForeArm"];

function jointOf([name, offset, below], kind) {
  const channels = kind === "ROOT" ? "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation" : TURNING.includes(name) ? "3 Zrotation Xrotation Yrotation" : "0";
  const end = `End Site\n{\nOFFSET ${name.endsWith("Leg") ? "0 -42 0" : name === "Head" ? "0 20 0" : name.startsWith("Right") ? "-15 0 0" : "15 0 0"}\n}\n`;
  const inner = below.length === 0 ? end : below.map((joint) => jointOf(joint, "JOINT")).join("");
  return `${kind} ${name}\n{\nOFFSET ${offset.join(" ")}\nCHANNELS ${channels}\n${inner}}\n`;
}

/** Someone waves, walks sideways by so many centimetres a frame and turns about the vertical: 30 frames a second. */
export function waving(frames, name = "waving.bvh", stride = 0.5) {
  const rows = Array.from({ length: frames }, (_, k) => {
    const swing = Math.sin(k / 6);
    return [k * stride, 95, 0, 0, 0, k * 0.4, 6 * swing, 0, 0, 30 * swing, 0, 0, 35 + 35 * swing, 0, 0].map((x) => x.toFixed(4)).join(" ");
  });
  const text = `HIERARCHY\n${jointOf(BODY, "ROOT")}MOTION\nFrames: ${frames}\nFrame Time: 0.0333333\n${rows.join("\n")}\n`;
  return { name, mimeType: "application/octet-stream", buffer: Buffer.from(text) };
}

/** A nod for the built-in creature, and the rig that says which of its bones nod. */
export function nodding(frames) {
  const rows = Array.from({ length: frames }, (_, k) => `0 0 0 0 0 0 ${(20 * Math.sin(0.3 * k)).toFixed(4)} 0 10`);
  const end = "End Site\n{\nOFFSET 30 0 0\n}\n";
  const head = `JOINT head\n{\nOFFSET 100 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n${end}}\n`;
  const root = `ROOT trunk\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n${head}}\n`;
  const text = `HIERARCHY\n${root}MOTION\nFrames: ${frames}\nFrame Time: 0.1\n${rows.join("\n")}\n`;
  const rig = {
    version: 1,
    joints: { tail: [-0.6, 1.0, 0], neck: [0.45, 1.05, 0], nose: [0.9, 1.25, 0] },
    bones: [
      { id: "trunk", from: "tail", to: "neck", joint: "trunk", rest: "ORIENTATION", radius: 0.3 },
      { id: "head", from: "neck", to: "nose", parent: "trunk", joint: "head", rest: "ORIENTATION", radius: 0.25 },
    ],
  };
  return [
    { name: "nodding.bvh", mimeType: "application/octet-stream", buffer: Buffer.from(text) },
    { name: "nodding.json", mimeType: "application/json", buffer: Buffer.from(JSON.stringify(rig)) },
  ];
}

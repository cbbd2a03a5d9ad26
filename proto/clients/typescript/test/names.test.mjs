/** Values of enums may be their names. */

import assert from "node:assert/strict";
import { create } from "@bufbuild/protobuf";
import { test } from "node:test";
import { schema, Stream } from "../dist/index.js";
import { numbered } from "../dist/names.js";
import { FakeSocket } from "./fake.mjs";

test("names become numbers wherever they stand, and all else stays", () => {
  const { OptionsSchema, HandleSchema, EditRequestSchema, Frame_Encoding, Options_Fit, Handle_Constrains, Falloff_Kind } = schema;
  assert.deepEqual(
    numbered(OptionsSchema, { tolerance: 1e-4, fit: "COARSE_FIRST", output: { encoding: "DELTA", normals: true } }),
    { tolerance: 1e-4, fit: Options_Fit.COARSE_FIRST, output: { encoding: Frame_Encoding.DELTA, normals: true } },
  );
  const given = { id: "DELTA", constrains: ["POSITION", Handle_Constrains.SCALE], falloff: { radius: 1, kind: "SMOOTH" } };
  const kept = structuredClone(given);
  assert.deepEqual(numbered(HandleSchema, given), {
    id: "DELTA",
    constrains: [Handle_Constrains.POSITION, Handle_Constrains.SCALE],
    falloff: { radius: 1, kind: Falloff_Kind.SMOOTH },
  });
  assert.deepEqual(given, kept, "what was given is not changed");
  const edit = numbered(EditRequestSchema, { on: "REST", operation: { case: "subdivide", value: { scheme: "LOOP" } } });
  assert.deepEqual(edit, { on: schema.EditRequest_On.REST, operation: { case: "subdivide", value: { scheme: schema.EditRequest_Subdivide_Scheme.LOOP } } });
  const message = create(OptionsSchema, { output: { encoding: Frame_Encoding.U16 } });
  assert.equal(numbered(OptionsSchema, message), message);
});

test("a name that there is not is told with its place and those that are, before anything is sent", () => {
  const says = { code: "INVALID_ARGUMENT", message: 'output.encoding is "delta"; one of F32, U16, MESHOPT, DELTA is allowed' };
  const route = { connect: () => new FakeSocket(), probe: async () => undefined, known: () => 0 };
  assert.throws(() => new Stream(route, { output: { encoding: "delta" } }, {}, 1), says);
  const stream = new Stream(route, { output: { encoding: "DELTA" } }, {}, 1);
  assert.throws(() => stream.setOptions({ output: { encoding: "delta" } }), says);
  stream.close();
});

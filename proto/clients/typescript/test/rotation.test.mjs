import assert from "node:assert/strict";
import { test } from "node:test";
import { nearestRotationVector, quaternionOf, turnsOf } from "../dist/index.js";

const DEGREES = Math.PI / 180;

function near(a, b, slack = 1e-9) {
  assert.ok(Math.hypot(...a.map((x, k) => x - b[k])) < slack, `${a} is not ${b}`);
}

test("a rotation vector survives its quaternion, whatever the axis", () => {
  for (const vector of [[0.3, 0, 0], [0, -2, 0.5], [1, 1, 1], [0, 0, 3.1], [1e-14, 0, 0]]) {
    near(nearestRotationVector(quaternionOf(vector), vector), vector);
  }
});

test("turning in steps counts turns in both directions", () => {
  for (const sign of [1, -1]) {
    const axis = [0.6, 0, 0.8];
    let vector = [0, 0, 0];
    for (let degrees = 0; degrees <= 900; degrees += 7.5) {
      const angle = sign * degrees * DEGREES;
      vector = nearestRotationVector(quaternionOf(axis.map((x) => x * angle)), vector);
      near(vector, axis.map((x) => x * angle), 1e-6);
    }
  }
});

test("a quaternion and its opposite are the same rotation", () => {
  const previous = [0, 3, 0];
  const q = quaternionOf([0, 3.3, 0]);
  near(nearestRotationVector(q.map((x) => -x), previous), [0, 3.3, 0]);
});

test("a whole turn keeps its axis, and unwinding ends at rest", () => {
  near(nearestRotationVector([0, 0, 0, -1], [0, 6.2, 0]), [0, 2 * Math.PI, 0]);
  near(nearestRotationVector([0, 0, 0, 1], [0, 6.2, 0]), [0, 2 * Math.PI, 0]);
  near(nearestRotationVector([0, 0, 0, 1], [0, 0.05, 0]), [0, 0, 0]);
});

test("turns are told as people say them", () => {
  assert.deepEqual(turnsOf(0), { turns: 0, degrees: 0 });
  assert.equal(turnsOf(400 * DEGREES).turns, 1);
  assert.ok(Math.abs(turnsOf(400 * DEGREES).degrees - 40) < 1e-9);
  assert.equal(turnsOf(-730 * DEGREES).turns, -2);
  assert.equal(turnsOf(2 * Math.PI - 1e-12).turns, 1);
  assert.equal(turnsOf(359 * DEGREES).turns, 0);
});

/** Sessions in three.js, which is needed here and nowhere else: `import { PliantGeometry } from "pliant-client/three"`. */

import { BufferAttribute, BufferGeometry, DynamicDrawUsage } from "three";
import type { Frame } from "./frames.js";
import type { Session } from "./session.js";
import type { Stream } from "./stream.js";

/**
 * The surface of a session, whose vertices move in place with its frames. Its coordinates are relative to `session.origin`, and a mesh of it
 * needs `frustumCulled = false`, or `computeBoundingSphere()` after each frame.
 */
export class PliantGeometry extends BufferGeometry {
  private constructor(positions: Float32Array, indices: Uint32Array, normals?: Float32Array) {
    super();
    this.setIndex(new BufferAttribute(indices, 1));
    this.setAttribute("position", new BufferAttribute(positions, 3).setUsage(DynamicDrawUsage));
    if (normals === undefined) this.computeVertexNormals();
    else this.setAttribute("normal", new BufferAttribute(normals, 3).setUsage(DynamicDrawUsage));
    this.computeBoundingSphere();
  }

  /** The current shape. After an edit of the session ask again. */
  static async of(session: Session): Promise<PliantGeometry> {
    const { positions, indices, normals } = await session.topology();
    return new PliantGeometry(positions, indices, normals);
  }

  /**
   * Takes the newest frame of a stream, in the animation frame; nothing where there is none. Normals are those of the frame
   * (`output: { normals: true }`), or computed.
   */
  take(stream: Stream): Frame | undefined {
    const { position, normal } = this.attributes as Record<"position" | "normal", BufferAttribute>;
    const frame = stream.take(position.array as Float32Array, normal.array as Float32Array);
    if (frame === undefined) return undefined;
    position.needsUpdate = normal.needsUpdate = true;
    if (!frame.hasNormals) this.computeVertexNormals();
    return frame;
  }
}

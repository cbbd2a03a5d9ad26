/** Materials that take paint by vertex: `paint.a` says how much of the surface below it covers. */

import type * as THREE from "three";

/** Has a material mix the attribute `paint` over its own colour. */
export function takePaint<M extends THREE.Material>(material: M): M {
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nattribute vec4 paint;\nvarying vec4 vPaint;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvPaint = paint;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nvarying vec4 vPaint;")
      .replace(
        "#include <alphamap_fragment>",
        // After the colours of texture and vertex. Paint is given as it shall look; lighting wants it linear.
        "diffuseColor.rgb = mix(diffuseColor.rgb, pow(vPaint.rgb, vec3(2.2)), vPaint.a);\n#include <alphamap_fragment>",
      );
  };
  return material;
}

/** What lies behind the wire, which is drawn on the same triangles. */
export const BEHIND_WIRE = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 } as const;

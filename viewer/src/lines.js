// Lines of many segments: thin ones for thousands, broad ones for what must be seen.
import { BufferAttribute, BufferGeometry, LineBasicMaterial, LineSegments } from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";

/** Segments as [x, y, z, x, y, z, ...] with a colour each end. */
export function thin(positions, colors, opacity = 1) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(positions), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colors), 3));
  const lines = new LineSegments(geometry, new LineBasicMaterial({ vertexColors: true, transparent: opacity < 1, opacity }));
  lines.frustumCulled = false;
  return lines;
}

export function broad(positions, colors, width) {
  const geometry = new LineSegmentsGeometry();
  geometry.setPositions(positions);
  geometry.setColors(colors);
  const lines = new LineSegments2(geometry, new LineMaterial({ vertexColors: true, linewidth: width }));
  lines.frustumCulled = false;
  return lines;
}

/** Frees what an object holds and takes it out of the scene. */
export function remove(object) {
  if (!object) return;
  object.removeFromParent();
  object.geometry.dispose();
  object.material.dispose();
}

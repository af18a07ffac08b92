// Where the model is and how large, without the strays: from its coarse points, else from the cameras.
import { Vector3 } from "three";
import { quantile } from "./format.js";

const SAMPLE = 30000;
const OUTSIDE = 0.02; // the share on each side that is left out

/** In the scene (y up): { centre, radius, least, most, low, high }: a box, and the heights of all but the strays. */
export function bounds(stage, frames, model) {
  const cameras = frames.placed.map(k => stage.toScene(frames.position(k))), points = [];
  const step = Math.max(1, Math.floor((model?.count ?? 0) / SAMPLE));
  let row = 0;
  model?.forEach((x, y, z) => row++ % step === 0 && points.push([x, y, z]));
  const seen = points.length ? points.map(p => stage.toScene(p)) : cameras.length ? cameras : [new Vector3()];
  const ends = ["x", "y", "z"].map(axis => {
    const values = seen.map(p => p[axis]);
    const own = cameras.map(p => p[axis]);
    return [Math.min(quantile(values, OUTSIDE), ...own), Math.max(quantile(values, 1 - OUTSIDE), ...own)];
  });
  const at = end => new Vector3(...ends.map(pair => pair[end]));
  const radius = Math.max(at(0).distanceTo(at(1)) / 2, 0.2);
  const heights = seen.map(p => p.y);
  return {
    centre: at(0).add(at(1)).multiplyScalar(0.5), radius, least: at(0), most: at(1),
    low: quantile(heights, 0.001) - 0.01 * radius, high: quantile(heights, 0.999) + 0.01 * radius,
  };
}

/** Where the cameras look on average, level, in the scene. */
export function heading(stage, frames) {
  const sum = new Vector3();
  for (const k of frames.placed) sum.add(new Vector3(0, 0, 1).applyQuaternion(frames.turn(k)));
  sum.applyQuaternion(stage.world.quaternion).setY(0);
  return sum.length() > 1e-6 ? sum.normalize() : new Vector3(0, 0, -1);
}

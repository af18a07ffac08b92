// Frames as the view needs them: which have poses, where each camera stands, and what is measured of each.
import { Quaternion, Vector3 } from "three";
import { known, quantile } from "./format.js";

export class Frames {
  constructor(columns, camera) {
    this.columns = columns;
    this.count = columns.pose.length;
    this.camera = camera ?? { left: 0.5, right: 0.5, top: 0.4, bottom: 0.4, width: 640, height: 480 };
    this.placed = [...Array(this.count).keys()].filter(k => columns.pose[k]);
    this.reach = this.extent();
  }

  position(k) {
    return this.columns.pose[k]?.slice(0, 3) ?? null;
  }

  turn(k) {
    return new Quaternion(...this.columns.pose[k].slice(3));
  }

  /** [centre, four corners of the image at `size` metres] in the world. */
  frustum(k, size) {
    const { left, right, top, bottom } = this.camera;
    const q = this.turn(k), at = new Vector3(...this.position(k));
    const corners = [[-left, -top], [right, -top], [right, bottom], [-left, bottom]];
    return [at, ...corners.map(([x, y]) => new Vector3(x, y, 1).multiplyScalar(size).applyQuaternion(q).add(at))];
  }

  /** Pairs of frames that follow each other within a piece. */
  steps() {
    const last = new Map(), found = [];
    for (const k of this.placed) {
      const piece = this.columns.piece[k];
      if (last.has(piece)) found.push([last.get(piece), k]);
      last.set(piece, k);
    }
    return found;
  }

  /** The size of the trajectory (m), without its farthest hundredth. */
  extent() {
    const sizes = [0, 1, 2].map(axis => {
      const values = this.placed.map(k => this.columns.pose[k][axis]);
      return (quantile(values, 0.99) ?? 0) - (quantile(values, 0.01) ?? 0);
    });
    return Math.max(Math.hypot(...sizes), 0.2);
  }

  /** What the path can be coloured by: column, words, unit; only what is known of a frame at least. */
  measures() {
    const all = [
      { key: "error_m", words: "error", scale: 100, unit: "cm" },
      { key: "difference_m", words: "difference", scale: 100, unit: "cm" },
      { key: "sigma_m", words: "uncertainty (1 sigma)", scale: 100, unit: "cm" },
      { key: "speed", words: "speed", scale: 1, unit: "m/s" },
    ];
    return all.filter(({ key }) => this.columns[key]?.some(known));
  }
}

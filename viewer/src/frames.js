// Frames as the view needs them: which have poses, where each camera stands, and what is measured of each.
import { Quaternion, Vector3 } from "three";
import { known, quantile } from "./format.js";

const MOST_STEPS = 2000; // of the path: more broad lines cost more than all points
const UNKNOWN_CAMERA = { left: 0.5, right: 0.5, top: 0.4, bottom: 0.4, width: 640, height: 480 };

export class Frames {
  /** `recordings`: of a map, { name, first, count, camera } of each; its frames are counted through. */
  constructor(columns, camera, recordings) {
    this.columns = columns;
    this.count = columns.pose.length;
    this.recordings = recordings ?? [{ name: null, first: 0, count: this.count, camera }];
    this.placed = [...Array(this.count).keys()].filter(k => columns.pose[k]);
    this.reach = this.extent();
  }

  /** The number of the recording that a frame is of. */
  recording(k) {
    return this.recordings.findLastIndex(({ first }) => k >= first);
  }

  /** The frame's number in its own recording. */
  number(k) {
    return k - this.recordings[this.recording(k)].first;
  }

  /** What a frame is called: by its number, and by its recording where there are several. */
  name(k) {
    const { name } = this.recordings[this.recording(k)];
    return name === null ? `${k}` : `${this.number(k)} of ${name}`;
  }

  camera(k) {
    return this.recordings[this.recording(k)].camera ?? UNKNOWN_CAMERA;
  }

  position(k) {
    return this.columns.pose[k]?.slice(0, 3) ?? null;
  }

  turn(k) {
    return new Quaternion(...this.columns.pose[k].slice(3));
  }

  /** [centre, four corners of the image at `size` metres] in the world. */
  frustum(k, size) {
    const { left, right, top, bottom } = this.camera(k);
    const q = this.turn(k), at = new Vector3(...this.position(k));
    const corners = [[-left, -top], [right, -top], [right, bottom], [-left, bottom]];
    return [at, ...corners.map(([x, y]) => new Vector3(x, y, 1).multiplyScalar(size).applyQuaternion(q).add(at))];
  }

  /** Pairs of frames that follow each other within a piece of a recording; of very many frames only some. */
  steps() {
    const every = Math.ceil(this.placed.length / MOST_STEPS), parts = new Map(), found = [];
    for (const k of this.placed) {
      const part = `${this.columns.piece[k]} ${this.recording(k)}`;
      if (!parts.has(part)) parts.set(part, []);
      parts.get(part).push(k);
    }
    for (const members of parts.values()) {
      const shown = members.filter((_, at) => at % every === 0 || at === members.length - 1);
      for (let at = 1; at < shown.length; at++) found.push([shown[at - 1], shown[at]]);
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
    const own = all.filter(({ key }) => this.columns[key]?.some(known));
    return this.recordings.length > 1 ? [{ key: "recording", words: "recording" }, ...own] : own;
  }
}

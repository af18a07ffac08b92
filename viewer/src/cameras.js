// The cameras as frusta and their path, coloured by what is measured of them.
import { Group } from "three";
import { ACCENT, APART, PATH, TRUTH, ramp, recordingColor } from "./colors.js";
import { known, quantile } from "./format.js";
import { broad, remove, thin } from "./lines.js";

const EDGES = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]]; // of a frustum: centre, four corners

const MOST_FRUSTA = 300; // more hide the model and each other

export class Cameras {
  constructor(frames, stage) {
    this.frames = frames;
    this.stage = stage;
    this.object = new Group();
    this.path = new Group();
    this.mark = new Group();
    stage.world.add(this.object, this.path, this.mark);
    this.every = Math.ceil(frames.placed.length / MOST_FRUSTA);
    this.size = Math.min(Math.max(frames.reach / 40, 0.02), 0.3);
    this.colorBy(null);
  }

  /** `measure`: one of frames.measures(), or null. Returns the range of its colours in its unit. */
  colorBy(measure) {
    const ofRecording = measure?.key === "recording";
    const values = measure && !ofRecording ? this.frames.columns[measure.key] : [];
    const top = values.length ? quantile(values, 0.98) || 1 : 1;
    this.color = k => {
      if (ofRecording) return recordingColor(this.frames.recording(k));
      if (this.frames.columns.piece[k] > 0) return APART;
      if (!measure) return PATH;
      return known(values[k]) ? ramp(values[k] / top) : TRUTH;
    };
    this.build();
    return [0, top * (measure?.scale ?? 1)];
  }

  build() {
    for (const group of [this.object, this.path]) while (group.children.length) remove(group.children[0]);
    const { frames } = this, positions = [], colors = [];
    for (let at = 0; at < frames.placed.length; at += this.every) {
      const k = frames.placed[at];
      const corners = frames.frustum(k, this.size), color = this.color(k);
      for (const [a, b] of EDGES) {
        positions.push(...corners[a], ...corners[b]);
        colors.push(...color, ...color);
      }
    }
    if (positions.length) this.object.add(thin(positions, colors));
    const along = [], shades = [];
    for (const [a, b] of frames.steps()) {
      along.push(...frames.position(a), ...frames.position(b));
      shades.push(...this.color(a), ...this.color(b));
    }
    if (along.length) this.path.add(broad(along, shades, 2.5));
    this.stage.invalidate();
  }

  get words() {
    return this.every > 1 ? `cameras (1 of ${this.every})` : "cameras";
  }

  /** Makes one camera stand out; null: none. */
  select(k) {
    while (this.mark.children.length) remove(this.mark.children[0]);
    if (known(k) && this.frames.position(k)) {
      const corners = this.frames.frustum(k, 1.8 * this.size);
      const lines = EDGES.flatMap(([a, b]) => [...corners[a], ...corners[b]]);
      this.mark.add(broad(lines, EDGES.flatMap(() => [...ACCENT, ...ACCENT]), 3));
    }
    this.stage.invalidate();
  }
}

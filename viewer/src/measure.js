// A distance between two points of the model.
import { Group } from "three";
import { ACCENT } from "./colors.js";
import { length } from "./format.js";
import { broad, remove } from "./lines.js";

export class Measure {
  constructor(stage, label) {
    Object.assign(this, { stage, label, points: [] });
    this.object = new Group();
    stage.world.add(this.object);
    stage.after.push(() => this.place());
  }

  /** Adds a point, the third begins anew. Returns what can be said. */
  add(point) {
    if (this.points.length === 2) this.points = [];
    this.points.push(point);
    this.build();
    if (this.points.length < 2) return "First point set; set the second.";
    return `Distance ${length(this.distance)}, ${length(Math.abs(this.rise))} of it in height.`;
  }

  clear() {
    this.points = [];
    this.build();
  }

  get distance() {
    const [a, b] = this.points;
    return Math.hypot(...a.map((v, k) => v - b[k]));
  }

  get rise() {
    const [a, b] = this.points.map(p => this.stage.toScene(p).y);
    return b - a;
  }

  build() {
    while (this.object.children.length) remove(this.object.children[0]);
    const [a, b] = this.points;
    if (!a) this.label.hidden = true;
    else {
      const arm = this.stage.metresPerPixel(this.stage.camera.position.distanceTo(this.stage.toScene(a))) * 7;
      const cross = p => [0, 1, 2].flatMap(axis =>
        [-arm, arm].flatMap(d => p.map((v, k) => (k === axis ? v + d : v))));
      const lines = [...cross(a), ...(b ? [...cross(b), ...a, ...b] : [])];
      const marks = broad(lines, Array.from({ length: lines.length / 3 }, () => ACCENT).flat(), 2.5);
      marks.material.depthTest = false;
      marks.renderOrder = 9;
      this.object.add(marks);
    }
    this.stage.invalidate();
  }

  /** Keeps the label at the middle of the line. */
  place() {
    if (this.points.length < 2) {
      this.label.hidden = true;
      return;
    }
    const [a, b] = this.points;
    const [x, y, depth] = this.stage.project(a.map((v, k) => (v + b[k]) / 2));
    this.label.hidden = depth > 1;
    this.label.textContent = length(this.distance);
    this.label.style.transform = `translate(${x.toFixed(0)}px, ${y.toFixed(0)}px) translate(-50%, -120%)`;
  }
}

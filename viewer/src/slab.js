// A level slab of the model: what is above and below is cut away, as for a floor plan.
import { Plane, Vector3 } from "three";

export class Slab {
  constructor(stage) {
    Object.assign(this, { stage, from: 0, to: 1, on: false });
    stage.renderer.localClippingEnabled = true;
    this.planes = []; // held by every material of the model; cameras and edges are never cut
    this.floor = new Plane(new Vector3(0, 1, 0), 0);
    this.ceiling = new Plane(new Vector3(0, -1, 0), 0);
    const rows = stage.world.matrixWorld.elements;
    this.rise = [rows[1], rows[5], rows[9]]; // height of a point of the result's world
  }

  /** `low`, `high`: heights (m) of the model in the scene, along y. */
  reach(low, high) {
    Object.assign(this, { low, high, from: low, to: high });
  }

  /** Sliders in hundredths of the model's height; the slab begins as what lies below a ceiling. */
  controls({ box, from, to, label }) {
    Object.assign(this, { box, label, ends: [from, to] });
    for (const control of [box, from, to]) control.addEventListener("input", () => this.show(box.checked));
    this.show(false);
  }

  /** The floor plan comes with the slab, and takes it away again where it was not there before. */
  plan(flat) {
    if (flat && this.before === undefined) this.before = this.on;
    this.show(flat || (this.before ?? this.on));
    if (!flat) this.before = undefined;
  }

  show(on) {
    const heights = this.ends.map(end => this.low + (Number(end.value) / 100) * (this.high - this.low));
    Object.assign(this, { on, from: Math.min(...heights), to: Math.max(...heights) });
    this.box.checked = on;
    this.floor.constant = -this.from;
    this.ceiling.constant = this.to;
    this.planes.splice(0, 2, ...(on ? [this.floor, this.ceiling] : []));
    const [a, b] = heights.map(height => `${(height - this.low).toFixed(2)} m`);
    this.label.textContent = `${a} to ${b}`;
    this.ends.forEach((end, k) => end.setAttribute("aria-valuetext", [a, b][k]));
    this.stage.invalidate();
  }

  /** Whether a point of the result's world is shown. */
  holds = (x, y, z) => {
    if (!this.on) return true;
    const height = this.rise[0] * x + this.rise[1] * y + this.rise[2] * z;
    return height >= this.from && height <= this.to;
  };
}

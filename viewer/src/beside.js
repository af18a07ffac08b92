// Another path beside that of the result, as the ground truth: its line, and a line to where each frame stands here.
import { Group } from "three";
import { broad, thin } from "./lines.js";

export class Beside {
  /** `positions`: one a frame, null where there is none. */
  constructor(positions, frames, color, stage) {
    this.object = new Group();
    const along = [], across = [];
    for (const [a, b] of frames.steps())
      if (positions[a] && positions[b]) along.push(...positions[a], ...positions[b]);
    positions.forEach((position, k) => {
      if (position && frames.position(k)) across.push(...position, ...frames.position(k));
    });
    const shade = lines => Array.from({ length: lines.length / 3 }, () => color).flat();
    if (along.length) this.object.add(broad(along, shade(along), 2));
    if (across.length) this.object.add(thin(across, shade(across), 0.7));
    for (const lines of this.object.children) lines.renderOrder = -1; // beneath the path, where it lies on it
    stage.world.add(this.object);
  }
}

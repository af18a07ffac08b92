// Words that stand beside places of the model: what hangs apart, and how many frames it is.
import { plural } from "./format.js";

export class Labels {
  constructor(element, frames, stage) {
    Object.assign(this, { stage, places: [] });
    const pieces = new Map();
    for (const k of frames.placed) {
      const piece = frames.columns.piece[k];
      if (!pieces.has(piece)) pieces.set(piece, []);
      pieces.get(piece).push(k);
    }
    for (const [piece, members] of [...pieces].filter(([piece]) => piece > 0)) {
      const label = document.createElement("span");
      label.className = "v-piece";
      label.textContent = `piece ${piece}: ${plural(members.length, "frame")}, joined to nothing else; its place is not known`;
      element.append(label);
      this.places.push({ label, at: frames.position(members[0]) });
    }
    stage.after.push(() => this.place());
  }

  place() {
    for (const { label, at } of this.places) {
      const [x, y, depth] = this.stage.project(at);
      label.hidden = depth > 1;
      // Kept within the picture, on whichever side it is.
      const left = Math.min(Math.max(x, 90), this.stage.width - 90);
      label.style.transform = `translate(${left.toFixed(0)}px, ${y.toFixed(0)}px) translate(-50%, 12px)`;
    }
  }
}

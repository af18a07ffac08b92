// The edges between cameras: which are shown, and what their colours say.
import { Group } from "three";
import { ACCENT, ORIGINS, VERDICTS, ramp, solverColor } from "./colors.js";
import { known, quantile } from "./format.js";
import { broad, remove, thin } from "./lines.js";

export class Edges {
  /** `matches`: those of all edges as unpackMatches gives them, one edge after the other. */
  constructor(columns, matches, frames, stage) {
    this.columns = columns;
    this.matches = matches;
    this.first = [0];
    for (const count of columns.drawn) this.first.push(this.first.at(-1) + count);
    this.frames = frames;
    this.stage = stage;
    this.object = new Group();
    this.mark = new Group();
    stage.world.add(this.object, this.mark);
    this.all = columns.i.map((_, e) => e);
    this.drawable = this.all.filter(e => frames.position(columns.i[e]) && frames.position(columns.j[e]));
    this.of = Array.from({ length: frames.count }, () => []);
    for (const e of this.all) for (const end of [columns.i[e], columns.j[e]]) this.of[end].push(e);
    this.worst = quantile(this.all.map(e => this.residual(e)), 0.98) || 1;
    this.shown = [];
    this.mode = "selected";
    this.by = "verdict";
    this.frame = null;
  }

  /** One number for degrees and metres, as the report sorts by: 1 degree counts as 2 cm. */
  residual(e) {
    const { deg, m } = this.columns;
    return known(deg[e]) && known(m[e]) ? deg[e] + 50 * m[e] : null;
  }

  /** What an edge is called: by its frames. */
  name(e) {
    return [this.columns.i[e], this.columns.j[e]].map(k => this.frames.name(k)).join("–");
  }

  /** Whether an edge leads from one recording to another. */
  joins(e) {
    return this.frames.recording(this.columns.i[e]) !== this.frames.recording(this.columns.j[e]);
  }

  verdict = e => this.columns.verdicts[this.columns.verdict[e]];

  color(e) {
    if (this.by === "solver") return solverColor(this.columns.solvers[this.columns.solver[e]]);
    if (this.by === "origin") return ORIGINS[this.columns.origin[e]];
    if (this.by === "residual") return known(this.residual(e)) ? ramp(this.residual(e) / this.worst) : VERDICTS.rejected;
    return VERDICTS[this.verdict(e)];
  }

  /** Entries of the legend: [words, colour]; null where it is the ramp. */
  legend() {
    const { columns, shown } = this;
    if (this.by === "residual") return null;
    if (this.by === "verdict") return Object.entries(VERDICTS);
    if (this.by === "origin") return columns.origins.map((words, k) => [words, ORIGINS[k]]);
    return [...new Set(shown.map(e => columns.solver[e]))].sort((a, b) => a - b)
      .map(number => [columns.solver_words[number], solverColor(columns.solvers[number])]);
  }

  wanted() {
    if (this.mode === "none") return [];
    if (this.mode === "selected") return this.drawable.filter(e => [this.columns.i[e], this.columns.j[e]].includes(this.frame));
    if (this.mode === "all") return this.drawable;
    if (this.mode === "between") return this.drawable.filter(e => this.joins(e) && this.verdict(e) !== "rejected");
    const verdicts = this.mode === "verified" ? ["verified"] : ["verified", "weak"];
    return this.drawable.filter(e => verdicts.includes(this.verdict(e)));
  }

  build() {
    while (this.object.children.length) remove(this.object.children[0]);
    this.shown = this.wanted();
    const positions = [], colors = [];
    // Rejected edges first, so that what holds the poses lies on top.
    for (const e of [...this.shown].sort((a, b) => this.columns.verdict[b] - this.columns.verdict[a])) {
      const color = this.color(e);
      positions.push(...this.ends(e).flat());
      colors.push(...color, ...color);
    }
    if (positions.length) this.object.add(this.shown.length > 200 ? thin(positions, colors, 0.45) : broad(positions, colors, 1.8));
    this.stage.invalidate();
  }

  /** The matches of an edge that can be drawn: { px, agrees }. */
  drawn(e) {
    const [from, to] = [this.first[e], this.first[e + 1]];
    return { px: this.matches.px.subarray(4 * from, 4 * to), agrees: this.matches.agrees.subarray(from, to) };
  }

  ends(e) {
    return [this.frames.position(this.columns.i[e]), this.frames.position(this.columns.j[e])];
  }

  /** Edges of a frame, verified first, the largest residual first. */
  ofFrame(k) {
    const order = e => this.columns.verdict[e] * 1e6 - (this.residual(e) ?? -1);
    return [...(this.of[k] ?? [])].sort((a, b) => order(a) - order(b));
  }

  find(i, j) {
    return this.ofFrame(i).find(e => this.columns.i[e] === i && this.columns.j[e] === j) ?? null;
  }

  select(e) {
    while (this.mark.children.length) remove(this.mark.children[0]);
    if (known(e) && this.drawable.includes(e))
      this.mark.add(broad(this.ends(e).flat(), [...ACCENT, ...ACCENT], 4));
    this.stage.invalidate();
  }
}

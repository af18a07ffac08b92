// What is known of the selected frame or edge, as text, images and buttons. Names are only ever set as text.
import { degrees, known, length, plural } from "./format.js";
import { matchPicture } from "./matches.js";

const MOST_LISTED = 60;

const FOUND_BY = {
  tracked: "points were followed to it from a keyframe; it has no edges of its own",
  keyframe: "matched with other keyframes",
};

export class Panel {
  /** `choose`: { frame(k), edge(e) } */
  constructor(element, frames, edges, source, choose) {
    Object.assign(this, { element, frames, edges, source, choose });
  }

  /** An element with text or children. */
  make(tag, content = [], attributes = {}) {
    const made = document.createElement(tag);
    made.append(...[content].flat());
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  }

  facts(rows) {
    const shown = rows.filter(([, value]) => known(value) && value !== "");
    return this.make("dl", shown.flatMap(([name, value]) => [this.make("dt", name), this.make("dd", String(value))]));
  }

  /** The facts that are shown, as one line. */
  read() {
    return [...(this.element.querySelector("dl")?.children ?? [])].map(part => part.textContent).join(" ");
  }

  nothing() {
    this.element.replaceChildren(this.make("p", "Click a camera or an edge, or step through the frames below."));
  }

  frame(k) {
    const { columns } = this.frames, own = this.edges.ofFrame(k);
    const lost = !columns.pose[k], apart = columns.piece[k] > 0;
    const rows = [
      ["time", `${columns.seconds[k].toFixed(2)} s (stamp ${columns.stamp[k]})`],
      ["pose", lost ? `none: ${columns.reason[k] || columns.status[k] || "not registered"}`
        : apart ? `in piece ${columns.piece[k]}: ${columns.reason[k] || "nothing joins it to the others"}` : FOUND_BY[columns.found_by[k]]],
      ["error", known(columns.error_m[k]) ? length(columns.error_m[k]) : null],
      ["difference", known(columns.difference_m?.[k]) ? length(columns.difference_m[k]) : null],
      ["uncertainty", known(columns.sigma_m[k]) ? `${length(columns.sigma_m[k])}, ${degrees(columns.sigma_deg[k])}` : null],
      ["speed", known(columns.speed[k]) ? `${columns.speed[k].toFixed(2)} m/s` : null],
      ["keypoints", columns.keypoints[k]],
    ];
    const parts = [this.make("h3", `Frame ${this.frames.name(k)}`), ...this.image(k), this.facts(rows)];
    const worst = own.find(e => this.edges.verdict(e) === "verified" && known(this.edges.residual(e)));
    if (known(worst)) parts.push(this.make("h4", "Its worst edge"), this.brief(worst), this.matches(worst));
    parts.push(...this.keyframes(k));
    if (own.length || columns.found_by[k] !== "tracked") parts.push(this.make("h4", plural(own.length, "edge")));
    const list = own.slice(0, MOST_LISTED).map(e => this.make("li", this.button(e, k)));
    parts.push(this.make("ul", list, { class: "v-edges" }));
    if (own.length > MOST_LISTED) parts.push(this.make("p", `${own.length - MOST_LISTED} more are not listed.`));
    this.element.replaceChildren(...parts);
  }

  /** Of a frame that was followed: the keyframes before and after it, whose edges hold it. */
  keyframes(k) {
    const { found_by: by } = this.frames.columns, r = this.frames.recording(k);
    if (by[k] !== "tracked") return [];
    const near = step => {
      let n = k + step;
      while (by[n] !== undefined && by[n] !== "keyframe") n += step;
      return by[n] !== undefined && this.frames.recording(n) === r ? n : null;
    };
    const ends = [near(-1), near(1)].filter(known).map(n => this.frameButton(n));
    return ends.length ? [this.make("h4", "Keyframes before and after it"), this.make("p", ends, { class: "v-ends" })] : [];
  }

  frameButton(k) {
    const button = this.make("button", `frame ${this.frames.name(k)}`, { type: "button" });
    button.addEventListener("click", () => this.choose.frame(k));
    return button;
  }

  image(k) {
    const picture = this.source.picture(k);
    if (!picture) return [];
    const image = this.make("img", [], { src: picture.src, alt: `colour image of frame ${this.frames.name(picture.frame)}` });
    image.addEventListener("error", () => image.replaceWith(this.make("p", "Its image cannot be read.")));
    const note = picture.frame === k ? [] : [
      this.make("p", `Image of frame ${this.frames.name(picture.frame)}, the nearest that this page carries; miniloop view shows all.`)];
    return [image, ...note];
  }

  /** One line: what an edge is worth. */
  line(e) {
    const { columns } = this.edges;
    const off = known(columns.deg[e]) ? `, ${degrees(columns.deg[e])}, ${length(columns.m[e])} off` : "";
    return `${this.edges.verdict(e)}${off}`;
  }

  button(e, k) {
    const { i, j } = this.edges.columns;
    const other = i[e] === k ? j[e] : i[e];
    const button = this.make("button", `to ${this.frames.name(other)}: ${this.line(e)}`, { type: "button", class: this.edges.verdict(e) });
    button.addEventListener("click", () => this.choose.edge(e));
    return button;
  }

  brief(e) {
    const { i, j } = this.edges.columns;
    const button = this.make("button", `${this.edges.name(e)}: ${this.line(e)}`, { type: "button", class: this.edges.verdict(e) });
    button.addEventListener("click", () => this.choose.edge(e));
    return button;
  }

  edge(e) {
    const { columns } = this.edges;
    const [i, j] = [columns.i[e], columns.j[e]];
    const solver = columns.solver_words[columns.solver[e]];
    const cycle = columns.cycle[e] === "" ? "" : `, cycle ${columns.cycle[e]}`;
    const rows = [
      ["verdict", this.edges.verdict(e)],
      ["why", this.why(e)],
      ["solver", `${solver}${cycle}`],
      ["matches", known(columns.matches[e]) ? `${columns.inliers[e]} of ${columns.matches[e]} agree` : known(columns.inliers[e]) ? `${columns.inliers[e]} agree` : null],
      ["residual", known(columns.deg[e]) ? `${degrees(columns.deg[e])}, ${length(columns.m[e])} to the final poses` : null],
      ["found in", columns.origins ? columns.origins[columns.origin[e]] : null],
    ];
    const ends = [i, j].map(k => this.frameButton(k));
    this.element.replaceChildren(
      this.make("h3", `Edge ${this.edges.name(e)}`), this.make("p", ends, { class: "v-ends" }), this.matches(e), this.facts(rows));
  }

  why(e) {
    const { columns } = this.edges;
    if (columns.reason[e]) return columns.reason[e];
    if (this.edges.verdict(e) !== "verified") return null;
    return columns.solvers[columns.solver[e]] === "followed"
      ? "points were followed from one frame to the other" : "enough matches agree, and nothing speaks against it";
  }

  /** How many of its matches are drawn, and what the colours of the lines say. */
  drawnWords(e, agrees) {
    const { inliers, matches } = this.edges.columns;
    const agree = agrees.reduce((sum, one) => sum + one, 0), others = agrees.length - agree;
    const some = (count, all) => (known(all) && all > count ? `${count} of ${all}` : `${count}`);
    if (!agrees.length) return this.edges.verdict(e) === "rejected" ? "No matches are kept of it." : "No matches that agree are kept of it.";
    if (!others) return `${some(agree, inliers[e])} matches that agree`;
    const all = known(matches[e]) && known(inliers[e]) ? matches[e] - inliers[e] : null;
    return `${some(agree, inliers[e])} matches that agree, in colours; ${some(others, all)} that do not, in red, dashed`;
  }

  /** The matches of an edge on its images; filled in when the images are there. */
  matches(e) {
    const { columns } = this.edges, holder = this.make("figure");
    const [i, j] = [columns.i[e], columns.j[e]];
    const [a, b] = [i, j].map(k => this.source.picture(k));
    if (!a || !b) return holder;
    if (a.frame !== i || b.frame !== j) {
      holder.append(this.make("figcaption", "This page does not carry both images; miniloop view shows all."));
      return holder;
    }
    const drawn = this.edges.drawn(e), said = this.drawnWords(e, drawn.agrees);
    const widths = [i, j].map(k => this.frames.camera(k).width);
    matchPicture(a.src, b.src, drawn, widths, `frames ${this.frames.name(i)} and ${this.frames.name(j)}: ${said}`)
      .then(canvas => holder.replaceChildren(canvas, this.make("figcaption", said)))
      .catch(() => holder.replaceChildren(this.make("figcaption", "Its images cannot be read.")));
    return holder;
  }
}

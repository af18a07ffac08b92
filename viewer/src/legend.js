// What the colours mean.
import { css, rampCss } from "./colors.js";

/** `entries`: { title, rows: [[words, colour]] } or { title, ramp: [low, high], unit }. */
export function drawLegend(element, entries) {
  element.replaceChildren(...entries.map(entry => {
    const line = document.createElement("p");
    line.append(`${entry.title} `);
    if (entry.ramp) {
      const bar = document.createElement("span");
      bar.className = "v-ramp";
      bar.style.backgroundImage = rampCss;
      const [low, high] = entry.ramp.map(v => Number(v.toPrecision(2)));
      line.append(`${low} `, bar, ` ${high}${entry.unit ? ` ${entry.unit}` : ""} and more`);
    }
    for (const [words, color] of entry.rows ?? []) {
      const mark = document.createElement("i");
      mark.style.backgroundColor = css(color);
      const key = document.createElement("span");
      key.className = "key";
      key.append(mark, words);
      line.append(key);
    }
    return line;
  }));
}

// Colours of what is drawn over the model: they stay apart for colour-blind eyes, on light and on dark.
const hex = text => [1, 3, 5].map(k => parseInt(text.slice(k, k + 2), 16) / 255);

export const ACCENT = hex("#e6007a");
export const PATH = hex("#2f7de1");
export const TRUTH = hex("#8a8f98");
export const OTHER = hex("#e08e0b");
export const APART = hex("#a05bd0");

// As in the report's charts.
const SOLVERS = {
  cycle7: hex("#c2185b"), cycle6: hex("#8e44ad"), cycle5: hex("#1f5fbf"), cycle4: hex("#2a9d8f"),
  cycle3: hex("#e08e0b"), planar4: hex("#2a9d8f"), planar3: hex("#e08e0b"), pairwise: hex("#8c939d"),
  planar2: hex("#8c939d"), followed: hex("#4db6d6"), guided: hex("#6b4f3a"),
};
export const VERDICTS = { verified: hex("#2f7de1"), weak: hex("#e08e0b"), rejected: hex("#d6402f") };
export const ORIGINS = [hex("#8a8f98"), hex("#2f7de1"), hex("#e08e0b")]; // both results, the first, the second

// Of Okabe and Ito (2008), without those that edges have.
const RECORDINGS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"].map(hex);
export const recordingColor = number => RECORDINGS[number % RECORDINGS.length];

export const solverColor = name => SOLVERS[name] ?? hex("#8c939d");

// Viridis at equal steps (Smith and van der Walt 2015), which grows evenly in lightness.
const RAMP = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"].map(hex);

/** The colour of a share in [0, 1]. */
export function ramp(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const k = Math.min(Math.floor(at), RAMP.length - 2);
  return RAMP[k].map((low, c) => low + (at - k) * (RAMP[k + 1][c] - low));
}

export const css = color => `rgb(${color.map(v => Math.round(255 * v)).join(" ")})`;

export const rampCss = `linear-gradient(to right, ${RAMP.map(css).join(", ")})`;

// Numbers as people read them.
export const known = value => value !== null && value !== undefined;

/** A length: m, cm or mm, three digits. */
export function length(m) {
  if (!known(m)) return "unknown";
  if (Math.abs(m) >= 1) return `${m.toFixed(2)} m`;
  return Math.abs(m) >= 0.01 ? `${(100 * m).toFixed(1)} cm` : `${(1000 * m).toFixed(1)} mm`;
}

export const degrees = deg => (known(deg) ? `${deg.toFixed(2)} deg` : "unknown");

export const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

/** The q-th quantile of the known values; null where there is none. */
export function quantile(values, q) {
  const sorted = values.filter(known).sort((a, b) => a - b);
  return sorted.length ? sorted[Math.min(Math.floor(q * sorted.length), sorted.length - 1)] : null;
}

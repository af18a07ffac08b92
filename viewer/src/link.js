// The part of the address that names what one looks at: #frame=52, #edge=3-17, with &eye= where from.
export function readLink() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const whole = text => (/^\d{1,9}$/.test(text ?? "") ? Number(text) : null);
  const pair = (parts.get("edge") ?? "").split("-");
  const eye = (parts.get("eye") ?? "").split(",").map(Number);
  return {
    frame: whole(parts.get("frame")),
    edge: pair.length === 2 && pair.every(text => whole(text) !== null) ? pair.map(Number) : null,
    eye: eye.length === 6 && eye.every(Number.isFinite) ? eye : null,
  };
}

/** Writes it without a new entry in the history. */
export function writeLink({ frame = null, edge = null, eye = null }) {
  const parts = [];
  if (frame !== null) parts.push(`frame=${frame}`);
  if (edge !== null) parts.push(`edge=${edge.join("-")}`);
  if (eye !== null) parts.push(`eye=${eye.map(v => v.toFixed(3)).join(",")}`);
  const hash = `#${parts.join("&")}`;
  if (location.hash !== hash && (parts.length || location.hash)) history.replaceState(null, "", hash);
  return location.href;
}

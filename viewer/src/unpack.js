// Points and matches as miniloop_cli/report/viewer packs them (packing.py, matches.py): deflated planes of bytes.

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

export function fromBase64(text) {
  const binary = atob(text.trim());
  const bytes = new Uint8Array(binary.length);
  for (let k = 0; k < binary.length; k++) bytes[k] = binary.charCodeAt(k);
  return bytes;
}

/** { steps: Uint16Array (3 n), colors: Uint8Array (3 n) }, point after point. */
export async function unpackPoints(bytes) {
  const planes = await inflated(bytes);
  const n = planes.length / 9;
  const steps = new Uint16Array(3 * n), colors = new Uint8Array(3 * n);
  for (let axis = 0; axis < 3; axis++) {
    const low = 2 * axis * n, high = low + n, shade = (6 + axis) * n, green = axis === 1 ? null : 7 * n;
    let step = 0, color = 0;
    for (let k = 0; k < n; k++) {
      step = (step + planes[low + k] + (planes[high + k] << 8)) & 0xffff;
      color = (color + planes[shade + k] + (green === null ? 0 : planes[green + k])) & 0xff;
      steps[3 * k + axis] = step;
      colors[3 * k + axis] = color;
    }
  }
  return { steps, colors };
}

/** { px: Uint16Array (4 n), u_i v_i u_j v_j of each match; agrees: Uint8Array (n) }; none of no bytes. */
export async function unpackMatches(bytes) {
  const planes = bytes.length ? await inflated(bytes) : new Uint8Array();
  const n = planes.length / 9, px = new Uint16Array(4 * n);
  for (let k = 0; k < n; k++)
    for (let c = 0; c < 4; c++) px[4 * k + c] = planes[c * n + k] + (planes[(4 + c) * n + k] << 8);
  return { px, agrees: planes.slice(8 * n) };
}

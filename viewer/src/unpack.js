// Points as miniloop_cli/report/viewer/packing.py packs them: deflated planes of bytes of differences.

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

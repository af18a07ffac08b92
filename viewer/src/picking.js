// What lies under a pixel: the nearest camera, edge or point of the model, measured on the screen.
const REACH_PX = 14;
const POINT_PX = 8;

/** The placed frame whose camera is nearest to (x, y); null beyond REACH_PX. */
export function frameAt(stage, frames, x, y) {
  let best = null, least = REACH_PX;
  for (const k of frames.placed) {
    const [u, v, depth] = stage.project(frames.position(k));
    const away = Math.hypot(u - x, v - y);
    if (depth < 1 && away < least) [best, least] = [k, away];
  }
  return best;
}

/** The shown edge whose line passes nearest to (x, y); null beyond half of REACH_PX. */
export function edgeAt(stage, edges, x, y) {
  let best = null, least = REACH_PX / 2;
  for (const e of edges.shown) {
    const [[ax, ay, az], [bx, by, bz]] = edges.ends(e).map(end => stage.project(end));
    if (az > 1 || bz > 1) continue;
    const along = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2 || 1);
    const t = Math.min(Math.max(along, 0), 1);
    const away = Math.hypot(ax + t * (bx - ax) - x, ay + t * (by - ay) - y);
    if (away < least) [best, least] = [e, away];
  }
  return best;
}

/** The point of the model that is seen at (x, y), [x, y, z] in the world of the result; null where there is none. */
export function pointAt(stage, model, shown, x, y) {
  const matrix = stage.camera.projectionMatrix.clone().multiply(stage.camera.matrixWorldInverse)
    .multiply(stage.world.matrixWorld).elements;
  const [a, b, c, d] = [0, 1, 3, 2].map(row => [matrix[row], matrix[row + 4], matrix[row + 8], matrix[row + 12]]);
  const dot = (m, px, py, pz) => m[0] * px + m[1] * py + m[2] * pz + m[3];
  const [cx, cy] = [(2 * x) / stage.width - 1, 1 - (2 * y) / stage.height];
  const [rx, ry] = [(2 * POINT_PX) / stage.width, (2 * POINT_PX) / stage.height];
  let best = null, least = Infinity;
  model.forEach((px, py, pz) => {
    const w = dot(c, px, py, pz);
    if (w <= 0) return;
    const u = dot(a, px, py, pz) / w - cx, v = dot(b, px, py, pz) / w - cy;
    if (Math.abs(u) > rx || Math.abs(v) > ry || !shown(px, py, pz)) return;
    // Near to the eye counts, and near to the pixel: what is a pixel farther off must be nearer to be taken.
    const z = dot(d, px, py, pz) / w + 0.002 * Math.hypot(u / rx, v / ry);
    if (z < least) [best, least] = [[px, py, pz], z];
  });
  return best;
}

// A cloud of points, coarse first: as many of them are drawn as the machine can while the view moves, all at rest.
import { BufferAttribute, BufferGeometry, Points, PointsMaterial } from "three";
import { FOV_DEG } from "./stage.js";

const PER_METRE = 1 / Math.tan((FOV_DEG * Math.PI) / 360); // three.js sizes points as if the view opened 90 deg
const FILL = 1.8; // squares a little larger than their distance leave no holes

/** Quantised points in a cube as a three.js object; `size_m` is set by who draws them. */
export function quantised({ steps, colors }, { corner, side }, clippingPlanes) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(steps, 3, true));
  geometry.setAttribute("color", new BufferAttribute(colors, 3, true));
  const points = new Points(geometry, new PointsMaterial({ vertexColors: true, clippingPlanes }));
  points.position.set(...corner);
  points.scale.setScalar(side);
  points.frustumCulled = false; // their bounds would be measured point by point
  return points;
}

/** Sets the size of points that stand `spacing` metres apart. */
export function spread(points, spacing, stage) {
  const flat = stage.camera === stage.orthographic;
  if (points.material.sizeAttenuation === flat) {
    points.material.sizeAttenuation = !flat;
    points.material.needsUpdate = true;
  }
  const size = FILL * spacing;
  points.material.size = flat ? Math.max((size / stage.metresPerPixel(0)) * stage.renderer.getPixelRatio(), 1) : size * PER_METRE;
}

export class CoarseFirst {
  /** `meta.levels[k]`: points of level k, which stand some side / 2^k apart. */
  constructor(arrays, meta, stage, pace, slab) {
    this.points = quantised(arrays, meta, slab.planes);
    this.arrays = arrays;
    this.meta = meta;
    this.count = meta.count;
    this.object = this.points;
    stage.before.push(() => this.prepare(stage, pace));
  }

  prepare(stage, pace) {
    const drawn = Math.min(this.count, pace.budget());
    this.points.geometry.setDrawRange(0, drawn);
    spread(this.points, this.spacing(drawn), stage);
    pace.drawn(drawn, this.count);
  }

  /** About how far apart the first `drawn` points stand; never less than most of all points do. */
  spacing(drawn) {
    const { levels, side } = this.meta;
    let before = 0;
    for (let level = 0; level < levels.length; level++) {
      const share = (Math.min(drawn, 0.9 * this.count) - before) / levels[level];
      if (share <= 1 || level === levels.length - 1) return side / 2 ** (level - 1 + Math.min(Math.max(share, 0), 1));
      before += levels[level];
    }
    return side;
  }

  /** Calls `visit(x, y, z)` with every point, in the world of the result. */
  forEach(visit) {
    const { corner, side } = this.meta, { steps } = this.arrays, unit = side / 65535;
    for (let k = 0; k < 3 * this.count; k += 3)
      visit(corner[0] + unit * steps[k], corner[1] + unit * steps[k + 1], corner[2] + unit * steps[k + 2]);
  }
}

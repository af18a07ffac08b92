// The uncertainty of each position: ellipsoids of 3 standard deviations, enlarged by a round number to be seen.
import { IcosahedronGeometry, InstancedMesh, Matrix4, MeshBasicMaterial, Quaternion, Vector3 } from "three";
import { PATH } from "./colors.js";
import { quantile } from "./format.js";

const SIGMAS = 3;
const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

export class Ellipsoids {
  constructor(frames, stage) {
    const rows = frames.placed.filter(k => frames.columns.ellipsoid[k]);
    this.known = rows.length > 0;
    if (!this.known) return;
    const longest = rows.map(k => Math.max(...frames.columns.ellipsoid[k].slice(0, 3)));
    const median = SIGMAS * (quantile(longest, 0.5) || 1e-6);
    this.factor = FACTORS.find(f => f * median >= frames.reach / 100) ?? FACTORS.at(-1);
    this.object = new InstancedMesh(
      new IcosahedronGeometry(1, 2), new MeshBasicMaterial({ transparent: true, opacity: 0.35, depthWrite: false }),
      rows.length,
    );
    this.object.material.color.setRGB(...PATH);
    rows.forEach((k, row) => {
      const [a, b, c, ...q] = frames.columns.ellipsoid[k];
      // Never thinner than a thousandth of the path: what is certain in one direction is still seen.
      const axes = [a, b, c].map(sigma => Math.max(sigma * SIGMAS * this.factor, frames.reach / 1000));
      const matrix = new Matrix4().compose(
        new Vector3(...frames.position(k)), new Quaternion(...q), new Vector3(...axes));
      this.object.setMatrixAt(row, matrix);
    });
    this.object.frustumCulled = false;
    stage.world.add(this.object);
  }

  get words() {
    return `${SIGMAS} sigma${this.factor > 1 ? `, ${this.factor} times enlarged` : ""}`;
  }
}

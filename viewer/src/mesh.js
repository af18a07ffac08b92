// A mesh as GLB, with its texture or the colours of its vertices, shown without light as the cameras saw it.
import { BufferAttribute, DoubleSide, Group, MeshBasicMaterial, NoColorSpace, Vector3 } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

const shown = light => (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);

/** Colours of vertices, which glTF has linear in light, as they are to be seen. */
function asSeen(geometry) {
  const linear = geometry.getAttribute("color");
  if (!linear) return false;
  const colors = new Float32Array(3 * linear.count);
  for (let k = 0; k < linear.count; k++)
    colors.set([linear.getX(k), linear.getY(k), linear.getZ(k)].map(shown), 3 * k);
  geometry.setAttribute("color", new BufferAttribute(colors, 3));
  return true;
}

/** Loads `source.model.url`; `turn`: quaternion from the file's axes to the world of the result. */
export async function openMesh(source, stage, slab) {
  const { url, turn } = source.model;
  const loaded = await new GLTFLoader().loadAsync(url);
  const object = new Group();
  object.quaternion.set(...(turn ?? [0, 0, 0, 1]));
  object.add(loaded.scene);
  stage.world.add(object);
  stage.world.updateMatrixWorld(true);
  const parts = [];
  loaded.scene.traverse(node => {
    if (!node.isMesh && !node.isPoints) return;
    const colored = asSeen(node.geometry);
    if (node.isMesh) {
      const { map, color } = node.material;
      if (map) map.colorSpace = NoColorSpace; // shown as it is stored
      node.material = new MeshBasicMaterial({ map, vertexColors: colored, side: DoubleSide });
      if (!map && !colored && color) node.material.color.copy(color);
    }
    node.material.clippingPlanes = slab.planes;
    parts.push(node);
  });
  const toWorld = stage.world.matrixWorld.clone().invert();
  return {
    object,
    count: parts.reduce((sum, node) => sum + node.geometry.getAttribute("position").count, 0),
    forEach(visit) {
      const p = new Vector3();
      for (const node of parts) {
        const positions = node.geometry.getAttribute("position"), matrix = toWorld.clone().multiply(node.matrixWorld);
        for (let k = 0; k < positions.count; k++) {
          p.fromBufferAttribute(positions, k).applyMatrix4(matrix);
          visit(p.x, p.y, p.z);
        }
      }
    },
  };
}

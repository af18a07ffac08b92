// The two images of an edge, one below the other, with its matches.
const HUES = [50, 85, 120, 155, 190, 225, 260, 295]; // of matches that agree; red is for those that do not
const HUE_STEP = 3;
const GAP_PX = 4; // between the images

function loaded(src) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = reject;
    image.src = src;
  });
}

/** A canvas with both images; `px`: u_i v_i u_j v_j of each match in pixels of the recorded images, `widths` wide. */
export async function matchPicture(left, right, { px, agrees }, widths, words) {
  const [a, b] = await Promise.all([loaded(left), loaded(right)]);
  const wide = Math.max(a.naturalWidth, b.naturalWidth, 320); // small images are enlarged, so that lines stay thin
  const [p, q] = [a, b].map(image => wide / image.naturalWidth);
  const canvas = document.createElement("canvas");
  const below = Math.round(a.naturalHeight * p) + GAP_PX;
  canvas.width = wide;
  canvas.height = below + Math.round(b.naturalHeight * q);
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", words);
  const pen = canvas.getContext("2d");
  pen.drawImage(a, 0, 0, wide, a.naturalHeight * p);
  pen.drawImage(b, 0, below, wide, b.naturalHeight * q);
  const [s, t] = widths.map(width => wide / width);
  const draw = (k, color, dash) => {
    pen.strokeStyle = pen.fillStyle = color;
    pen.setLineDash(dash);
    const [ua, va, ub, vb] = px.subarray(4 * k, 4 * k + 4);
    const ends = [[ua * s, va * s], [ub * t, below + vb * t]];
    pen.beginPath();
    pen.moveTo(...ends[0]);
    pen.lineTo(...ends[1]);
    pen.stroke();
    for (const [x, y] of ends) pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  };
  // Those that agree on top.
  for (let k = 0; k < agrees.length; k++) if (!agrees[k]) draw(k, "hsl(0 95% 62% / 0.85)", [5, 4]);
  for (let k = 0; k < agrees.length; k++)
    if (agrees[k]) draw(k, `hsl(${HUES[(HUE_STEP * k) % HUES.length]} 90% 60%)`, []);
  return canvas;
}

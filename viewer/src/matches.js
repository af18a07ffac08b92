// The two images of an edge side by side, with its matches.
const HUES = [50, 85, 120, 155, 190, 225, 260, 295]; // of matches that agree; red is for those that do not
const HUE_STEP = 3;

function loaded(src) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = reject;
    image.src = src;
  });
}

/** A canvas with both images; `px`: u_i v_i u_j v_j of each match in the recording's pixels, `width` wide images. */
export async function matchPicture(left, right, { px, agrees }, width, words) {
  const [a, b] = await Promise.all([loaded(left), loaded(right)]);
  const wide = Math.max(a.naturalWidth, b.naturalWidth, 320); // small images are enlarged, so that lines stay thin
  const [p, q] = [a, b].map(image => wide / image.naturalWidth);
  const canvas = document.createElement("canvas");
  canvas.width = 2 * wide;
  canvas.height = Math.round(Math.max(a.naturalHeight * p, b.naturalHeight * q));
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", words);
  const pen = canvas.getContext("2d");
  pen.drawImage(a, 0, 0, wide, a.naturalHeight * p);
  pen.drawImage(b, wide, 0, wide, b.naturalHeight * q);
  const scale = wide / width;
  const draw = (k, color, dash) => {
    pen.strokeStyle = pen.fillStyle = color;
    pen.setLineDash(dash);
    const [ua, va, ub, vb] = px.subarray(4 * k, 4 * k + 4);
    const ends = [[ua * scale, va * scale], [wide + ub * scale, vb * scale]];
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

// The two images of an edge side by side, with its matches.
const HUE_STEP = 47;

function loaded(src) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = reject;
    image.src = src;
  });
}

/** A canvas with both images; `px`: u_i v_i u_j v_j of each match in the recording's pixels, `width` wide images. */
export async function matchPicture(left, right, px, width, words) {
  const [a, b] = await Promise.all([loaded(left), loaded(right)]);
  const canvas = document.createElement("canvas");
  canvas.width = a.naturalWidth + b.naturalWidth;
  canvas.height = Math.max(a.naturalHeight, b.naturalHeight);
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", words);
  const pen = canvas.getContext("2d");
  pen.drawImage(a, 0, 0);
  pen.drawImage(b, a.naturalWidth, 0);
  const [p, q] = [a.naturalWidth / width, b.naturalWidth / width];
  for (let k = 0; k < px.length; k += 4) {
    pen.strokeStyle = pen.fillStyle = `hsl(${(k / 4) * HUE_STEP % 360} 90% 60%)`;
    const ends = [[px[k] * p, px[k + 1] * p], [a.naturalWidth + px[k + 2] * q, px[k + 3] * q]];
    pen.beginPath();
    pen.moveTo(...ends[0]);
    pen.lineTo(...ends[1]);
    pen.stroke();
    for (const [x, y] of ends) pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  }
  return canvas;
}

// The boxes that show and hide a kind of thing, one a layer that there is.
export function layerBoxes(element, layers, stage) {
  element.replaceChildren(...layers.map(({ words, objects, on }) => {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = on;
    const show = () => {
      for (const object of objects) object.visible = box.checked;
      stage.invalidate();
    };
    box.addEventListener("change", show);
    show();
    label.append(box, ` ${words}`);
    return label;
  }));
}

"use strict";
// Files that the page makes when a reader saves them.
const offer = (name, blob) => {
  const link = document.createElement("a");
  link.download = name;
  link.href = URL.createObjectURL(blob);
  link.click();
  URL.revokeObjectURL(link.href);
};

// A drawing as PNG of that many pixels, on a colour.
const savePicture = (name, drawing, [width, height], background) => {
  drawing.setAttribute("width", width);
  drawing.setAttribute("height", height);
  const image = new Image();
  image.onload = () => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d");
    context.fillStyle = background;
    context.fillRect(0, 0, width, height);
    context.drawImage(image, 0, 0, width, height);
    canvas.toBlob((blob) => offer(name, blob));
  };
  image.src = `data:image/svg+xml,${encodeURIComponent(new XMLSerializer().serializeToString(drawing))}`;
};

// Still pictures in ink on white, twice as fine as they are drawn.
for (const link of document.querySelectorAll("a[data-picture]")) {
  link.hidden = false;
  link.href = "#";
  link.addEventListener("click", (event) => {
    event.preventDefault();
    const drawing = link.closest("figure").querySelector("svg").cloneNode(true);
    const [, , width, height] = drawing.getAttribute("viewBox").split(" ").map(Number);
    drawing.style.color = "#1d2228";
    savePicture(link.dataset.picture, drawing, [Math.round(2 * width), Math.round(2 * height)], "#ffffff");
  });
}

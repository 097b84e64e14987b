"use strict";

// The gallery: before and after behind a divider, or the two eyes of one method.
(() => {
  const store = document.getElementById("pictures");
  if (!store) return;
  const scenes = JSON.parse(store.textContent);
  const element = (id) => document.getElementById(id);
  const canvas = element("canvas");
  const context = canvas.getContext("2d");
  const view = { x: 0.5, y: 0.5 };
  const loaded = new Map();

  function image(uri) {
    if (!loaded.has(uri)) {
      const picture = new Image();
      picture.onload = draw;
      picture.src = uri;
      loaded.set(uri, picture);
    }
    return loaded.get(uri);
  }

  function fill(select, names, chosen) {
    select.replaceChildren(...names.map((name) => {
      const option = document.createElement("option");
      option.value = option.textContent = name;
      option.selected = name === chosen;
      return option;
    }));
  }

  const scene = () => scenes[element("scene").selectedIndex];
  const zoom = () => Number(element("zoom").value);
  const whole = () => zoom() === 1;

  function chooseScene() {
    const names = Object.keys(scene().left);
    fill(element("first"), names, names[0]);
    fill(element("second"), names, names[names.length - 2] || names[names.length - 1]);
    view.x = view.y = 0.5;
    draw();
  }

  // Draw a picture into a part of the canvas, as much of it as zoom and place say.
  function place(picture, left, top, width, height) {
    if (!picture.complete || !picture.naturalWidth) return false;
    const scale = Math.min(width / picture.naturalWidth, height / picture.naturalHeight) * zoom();
    const shownWidth = Math.min(width / scale, picture.naturalWidth);
    const shownHeight = Math.min(height / scale, picture.naturalHeight);
    const x = Math.min(Math.max(view.x * picture.naturalWidth - shownWidth / 2, 0),
                       picture.naturalWidth - shownWidth);
    const y = Math.min(Math.max(view.y * picture.naturalHeight - shownHeight / 2, 0),
                       picture.naturalHeight - shownHeight);
    context.imageSmoothingEnabled = scale < 2;
    context.drawImage(picture, x, y, shownWidth, shownHeight,
                      left + (width - shownWidth * scale) / 2,
                      top + (height - shownHeight * scale) / 2,
                      shownWidth * scale, shownHeight * scale);
    return true;
  }

  function clear() {
    context.globalCompositeOperation = "source-over";
    context.fillStyle = "#303030";
    context.fillRect(0, 0, canvas.width, canvas.height);
  }

  // One eye in one colour; the pictures are grey, so that a product with it does.
  function tinted(picture, colour) {
    const layer = document.createElement("canvas");
    layer.width = picture.naturalWidth;
    layer.height = picture.naturalHeight;
    const pen = layer.getContext("2d");
    pen.drawImage(picture, 0, 0);
    pen.globalCompositeOperation = "multiply";
    pen.fillStyle = colour;
    pen.fillRect(0, 0, layer.width, layer.height);
    return Object.assign(layer, { complete: true, naturalWidth: layer.width,
                                  naturalHeight: layer.height });
  }

  function draw() {
    const mode = element("mode").value;
    const first = element("first").value;
    const second = element("second").value;
    const { width, height } = canvas;
    canvas.style.touchAction = whole() ? "pan-y" : "none";
    clear();
    if (mode === "slider") {
      const line = Math.round(Number(element("divider").value) * width);
      for (const [name, from, to] of [[first, 0, line], [second, line, width]]) {
        context.save();
        context.beginPath();
        context.rect(from, 0, to - from, height);
        context.clip();
        place(image(scene().left[name]), 0, 0, width, height);
        context.restore();
      }
      context.fillStyle = "#ffffff";
      context.fillRect(line - 1, 0, 2, height);
      element("legend").textContent = `${first} | ${second}`;
      return;
    }
    const eyes = [image(scene().left[second]), image(scene().right[second] || "")];
    if (!scene().right[second]) {
      element("legend").textContent = `${second}: only one eye is here`;
      return;
    }
    if (!eyes.every((eye) => eye.complete && eye.naturalWidth)) return;
    if (mode === "anaglyph") {
      place(tinted(eyes[0], "#ff0000"), 0, 0, width, height);
      context.globalCompositeOperation = "lighter";
      place(tinted(eyes[1], "#00ffff"), 0, 0, width, height);
      context.globalCompositeOperation = "source-over";
      element("legend").textContent = `${second}: red-cyan glasses, red before the left eye`;
      return;
    }
    const order = mode === "cross" ? [eyes[1], eyes[0]] : eyes;
    place(order[0], 0, 0, width / 2 - 2, height);
    place(order[1], width / 2 + 2, 0, width / 2 - 2, height);
    element("legend").textContent = mode === "cross"
      ? `${second}: cross your eyes until the two become three`
      : `${second}: left eye on the left`;
  }

  function move(dx, dy) {
    view.x = Math.min(Math.max(view.x + dx / zoom(), 0), 1);
    view.y = Math.min(Math.max(view.y + dy / zoom(), 0), 1);
    draw();
  }

  function divide(x) {
    element("divider").value = x;
    draw();
  }

  function magnify(step) {
    element("zoom").value = zoom() + step;
    draw();
  }

  function position(event) {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    const [x, y] = position(event);
    const near = whole() || Math.abs(x - element("divider").value) < 0.02;
    held = { x, y, divider: near && element("mode").value === "slider" };
    canvas.setPointerCapture(event.pointerId);
    if (held.divider) divide(x);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    const [x, y] = position(event);
    if (held.divider) {
      divide(x);
    } else {
      move(held.x - x, held.y - y);
      held = { ...held, x, y };
    }
  });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("pointercancel", () => { held = null; });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    magnify(event.deltaY < 0 ? 0.5 : -0.5);
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1],
                    ArrowDown: [0, 0.1] };
    const factors = { "+": 0.5, "=": 0.5, "-": -0.5 };
    if (event.key in factors) {
      magnify(factors[event.key]);
    } else if (event.key in steps && whole()) {
      divide(Number(element("divider").value) + steps[event.key][0] / 5);
    } else if (event.key in steps) {
      move(...steps[event.key]);
    } else {
      return;
    }
    event.preventDefault();
  });
  for (const id of ["first", "second", "mode", "zoom", "divider"]) {
    element(id).addEventListener("input", draw);
  }
  fill(element("scene"), scenes.map((entry) => entry.title));
  element("scene").addEventListener("input", chooseScene);
  chooseScene();
})();

/** The captions A and B, drawn as pictures for both eyes. */

const HEIGHT = 240;

/** Return {A, B}: sources of a letter each on the surround's grey. */
export function makeLetters(drawing, grey) {
  return Object.fromEntries(
    ["A", "B"].map((letter) => {
      const canvas = document.createElement("canvas");
      canvas.width = HEIGHT;
      canvas.height = HEIGHT;
      const context = canvas.getContext("2d");
      context.fillStyle = `rgb(${grey} ${grey} ${grey})`;
      context.fillRect(0, 0, HEIGHT, HEIGHT);
      context.fillStyle = grey > 110 ? "#222" : "#ddd";
      context.font = `600 ${HEIGHT * 0.75}px "DejaVu Sans", "Noto Sans", Arial, sans-serif`;
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillText(letter, HEIGHT / 2, HEIGHT * 0.54);
      return [letter, drawing.fromPicture(canvas, { stereo: false })];
    }),
  );
}

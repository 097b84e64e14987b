/** Shows a stereo source on a flat screen in front of the eyes of a WebXR headset. */

import { makeProgram, setSource, uniformsOf } from "./drawing.js";
import { screenSize } from "./layout.js";
import { HEADSET, SCREEN_IN_SPACE } from "./shaders.js";

/** Distance from the eyes to the screen, metres. */
export const SCREEN_DISTANCE = 2;

/** Tell whether this browser has a headset that can show pictures to both eyes. */
export async function hasHeadset() {
  return Boolean(navigator.xr) && (await navigator.xr.isSessionSupported("immersive-vr"));
}

/** Return half the width and height of the screen, metres: the profile's angle at that distance. */
export function screenExtent(profile) {
  const [width, height] = screenSize(profile);
  const halfHeight = SCREEN_DISTANCE / profile.distance_heights / 2;
  return [(halfHeight * width) / height, halfHeight];
}

/** A session of the headset; `onFrame(time)` is asked for what to draw at each of its frames. */
export class Headset {
  constructor(drawing) {
    this.drawing = drawing;
    const { gl } = drawing;
    this.program = makeProgram(gl, SCREEN_IN_SPACE, HEADSET);
    this.uniforms = uniformsOf(gl, this.program);
  }

  /** Begin; call from a click or key. `onEnd` is called when the headset is taken off for good. */
  async begin(onEnd) {
    const { gl } = this.drawing;
    this.session = await navigator.xr.requestSession("immersive-vr");
    this.session.addEventListener("end", onEnd);
    await gl.makeXRCompatible();
    const layer = new XRWebGLLayer(this.session, gl, { antialias: false, alpha: false });
    await this.session.updateRenderState({ baseLayer: layer });
    this.space = await this.session.requestReferenceSpace("viewer");
  }

  requestFrame(callback) {
    this.session.requestAnimationFrame((time, frame) => {
      this.frame = frame;
      callback(time);
    });
  }

  /** Draw a source to both eyes; only inside a callback of `requestFrame`. */
  draw(source, surround) {
    const { gl, profile } = this.drawing;
    const pose = this.frame.getViewerPose(this.space);
    const layer = this.session.renderState.baseLayer;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(...surround.map((value) => value / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!pose) return;
    gl.useProgram(this.program);
    const at = this.uniforms;
    const screen = screenSize(profile);
    setSource(gl, at, source, surround, screen, profile.swap);
    gl.uniform2i(at.screenSize, ...screen);
    gl.uniform3f(at.place, 0, 0, -SCREEN_DISTANCE);
    gl.uniform2f(at.extent, ...screenExtent(profile));
    for (const view of pose.views) {
      const port = layer.getViewport(view);
      gl.viewport(port.x, port.y, port.width, port.height);
      gl.uniformMatrix4fv(at.projection, false, view.projectionMatrix);
      gl.uniformMatrix4fv(at.view, false, view.transform.inverse.matrix);
      gl.uniform1i(at.eye, view.eye === "right" ? 1 : 0);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
  }

  end() {
    return this.session.end();
  }
}

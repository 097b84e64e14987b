"""An RTSP server with live cameras, of GStreamer: ``rtsp_server.py PORT FPS CAMERA...``.

Run by the system's Python, for whose GObject Debian has the bindings; says ``ready`` once it is.
A camera is ``NAME``, or ``NAME:udp``: it sends by UDP alone. The user is ``ann``, the password
``secret``.
"""

import sys
import threading
import time
from functools import partial

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtsp", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtsp, GstRtspServer  # noqa: E402

WIDTH, HEIGHT = 64, 48
FIRST_LEVEL, STEP, LEVELS = 40, 8, 20
"""Grey of the pictures, as of :mod:`tests.support.camera`."""

LAUNCH = (
    "( appsrc name=source is-live=true do-timestamp=true format=time caps=video/x-raw,format=I420,"
    f"width={WIDTH},height={HEIGHT},framerate=%d/1 ! openh264enc gop-size=%d ! h264parse "
    "! queue ! rtph264pay name=pay0 pt=96 config-interval=-1 )"
)

VIEWER = "viewer, media.factory.access=(boolean)true, media.factory.construct=(boolean)true;"


def main(port, fps, cameras):
    Gst.init(None)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(port)
    token = GstRtspServer.RTSPToken()
    token.set_string("media.factory.role", "viewer")
    auth = GstRtspServer.RTSPAuth()
    auth.add_basic(GstRtspServer.RTSPAuth.make_basic("ann", "secret"), token)
    server.set_auth(auth)
    for camera in cameras:
        name, _, kind = camera.partition(":")
        factory = GstRtspServer.RTSPMediaFactory()
        factory.set_launch(LAUNCH % (fps, fps))
        factory.set_shared(True)
        factory.add_role_from_structure(Gst.Structure.new_from_string(VIEWER))
        factory.connect("media-configure", _configure, fps)
        if kind == "udp":
            factory.set_protocols(GstRtsp.RTSPLowerTrans.UDP)
        server.get_mount_points().add_factory(f"/{name}", factory)
    server.attach(None)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    GLib.MainLoop().run()


def _configure(factory, media, fps):
    stop = threading.Event()
    media.connect("unprepared", lambda media: stop.set())
    source = media.get_element().get_child_by_name("source")
    threading.Thread(target=partial(_push, source, stop, fps), daemon=True).start()


def _push(source, stop, fps):
    number = int(time.monotonic() * fps) + 1
    while not stop.wait(max(0.0, number / fps - time.monotonic())):
        level = FIRST_LEVEL + STEP * (number % LEVELS)
        planes = bytes([level]) * (WIDTH * HEIGHT) + b"\x80" * (WIDTH * HEIGHT // 2)
        if source.emit("push-buffer", Gst.Buffer.new_wrapped(planes)) != Gst.FlowReturn.OK:
            return
        number += 1


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])

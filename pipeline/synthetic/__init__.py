"""The rendered sample scene: pictures of our own, and the whole truth about them.

* :mod:`stage`: what stands where and how it moves;
* :mod:`textures`: what the surfaces look like, painted by :mod:`paint_room`, :mod:`paint_things`
  and :mod:`paint_print` with the tools of :mod:`patterns`;
* :mod:`rig`: the cameras before it;
* :mod:`rendering`: HR pictures of the stage, by the compiled loops of :mod:`raycast`;
* :mod:`observation`: from an HR picture to what cameras and stereo matchers deliver;
* :mod:`scene`: all of it put together: frames and their truth;
* :mod:`writing`: the same as files.
"""

from pipeline.synthetic.scene import SampleScene, SampleTruth, TrueMotion
from pipeline.synthetic.writing import write_scene

__all__ = ["SampleScene", "SampleTruth", "TrueMotion", "write_scene"]

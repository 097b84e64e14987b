"""The rendered sample scene: pictures of our own, and the whole truth about them.

* :mod:`stage`: what stands where and how it moves;
* :mod:`textures`: what the surfaces look like, with the tools of :mod:`patterns`;
* :mod:`raycast`: compiled rendering;
* :mod:`observation`: from an HR picture to what cameras and stereo matchers deliver;
* :mod:`scene`: the rig, its frames, their truth;
* :mod:`writing`: the same as files.
"""

from pipeline.synthetic.scene import SampleScene, SampleTruth, TrueMotion
from pipeline.synthetic.writing import write_scene

__all__ = ["SampleScene", "SampleTruth", "TrueMotion", "write_scene"]

"""The rendered sample scene: pictures of our own, and the whole truth about them.

* :mod:`stage`: what stands where and how it moves;
* :mod:`textures`: what the surfaces look like;
* :mod:`raycast`: compiled rendering;
* :mod:`observation`: from an HR picture to what cameras and stereo matchers deliver;
* :mod:`scene`: the rig, its frames, their truth.
"""

from pipeline.synthetic.scene import SampleScene, SampleTruth, TrueMotion

__all__ = ["SampleScene", "SampleTruth", "TrueMotion"]

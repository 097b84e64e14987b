"""One multi-view frame in, super-resolved reference views out: the order of the stages.

Registration says where each LR pixel lands and whether to trust it; reconstruction
consumes that and knows nothing of depth, layers or cameras. Here the
:class:`RegisteredView` records go from one to the other, and what happened is accounted for.

* :mod:`both_halves`: a frame from its views to its images;
* :mod:`register`: the first half, views registered onto the targets;
* :mod:`registered`: what it hands to the second;
* :mod:`reconstruct`: the second half, images of the targets;
* :mod:`restore`: images of a frame for which nothing is registered;
* :mod:`follow`: what moves in such a frame, taken from the frame before and the other eye;
* :mod:`anew`: motions of another picture, found a few in each frame;
* :mod:`due`: what of them is made again in a chain of frames, and how thoroughly;
* :mod:`chain`: what of the frames before holds for a frame;
* :mod:`memory`: what one frame of a chain leaves to the next;
* :mod:`seen`: the part of that which looking at the views has told;
* :mod:`colours`: the colour of an image, as large as it is wanted;
* :mod:`choices`: what the settings leave open;
* :mod:`account`: what is said of a frame;
* :mod:`stages`: how long its stages took.
"""

from pipeline.superresolve.anew import begin_anew, go_on_anew
from pipeline.superresolve.both_halves import superresolve
from pipeline.superresolve.choices import (
    chosen_filters,
    chosen_method,
    default_residual_threshold,
    default_weight_threshold,
    given_psf,
    terms_of,
)
from pipeline.superresolve.memory import Memory
from pipeline.superresolve.reconstruct import reconstruct_frame
from pipeline.superresolve.register import register_frame
from pipeline.superresolve.registered import RegisteredFrame

__all__ = [
    "Memory",
    "RegisteredFrame",
    "begin_anew",
    "chosen_filters",
    "chosen_method",
    "default_residual_threshold",
    "default_weight_threshold",
    "given_psf",
    "go_on_anew",
    "reconstruct_frame",
    "register_frame",
    "superresolve",
    "terms_of",
]

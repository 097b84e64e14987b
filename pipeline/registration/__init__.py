"""Where each pixel of a view lands in a reference view, and whether to trust it (thesis chapter 2).

Views in, :class:`pipeline.frames.RegisteredView` out; nothing here knows of a fine grid or a PSF.
Positions and displacements are LR pixels, x to the right and y down; depth is nearness.

* :mod:`register`: all views of a frame, in which order; :mod:`pair`: one view onto one reference;
  :mod:`records`: what comes out, and what a chain of frames keeps of it;
* :mod:`method`: Table 1's methods and ours, as switches;
* :mod:`prepare`: what is needed of one view, computed once;
* :mod:`parallax`: the motion of a view as a whole, a homography and an epipole, with
  :mod:`match_kernels` and :mod:`parallax_kernels`;
* ours: :mod:`windows` with :mod:`window_fits`, :mod:`window_kernels`, :mod:`choice_kernels`;
* the thesis': :mod:`strips` of :mod:`layers`; both cut by :mod:`patches` and moved as
  :mod:`motions` says, with :mod:`kernels`;
* :mod:`verification`, :mod:`verdict`: weights (Eq. 3), and which pixels are trusted (Eq. 4);
* from the previous frame: :mod:`again` (a rig that stands still), :mod:`moved` (one that does
  not), :mod:`by_depth` (without a fit; of depth maps that :mod:`cleaning` has cleaned where they
  are needed, both by :mod:`depth_vectors`); :mod:`carried` and :mod:`inverse` spare the fits onto
  a second reference.
"""

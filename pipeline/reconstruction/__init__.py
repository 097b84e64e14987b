"""One fine image from views that are registered onto it (thesis chapter 3).

:class:`pipeline.frames.RegisteredView` in, an image on the HR grid out; nothing here knows of
depth, layers or cameras. Intensities are grey levels, places HR pixels where nothing else is said.

* :mod:`fused`: the default solver; its normal equations are :mod:`system`, solved by
  :mod:`sweeps` over bands of rows, as :mod:`descent` says, with :mod:`half_pixels`,
  :mod:`kernels`, :mod:`rows` and :mod:`simd`;
* :mod:`pocs`: the thesis' own solvers (Eq. 7 to 10);
* :mod:`restoration`: a view enlarged by itself, where the default starts; :mod:`learned` with
  :mod:`filter_kernels`: what learned filters add to it and to the result;
* :mod:`agreement` with :mod:`median`: weights, and what is left over; :mod:`realign`: landing
  points corrected by what is predicted;
* :mod:`psf`: the point spread function; :mod:`coverage`: the sub-pixel phases that are filled;
* in a chain of frames: :mod:`again`, :mod:`boxes` and :mod:`parts` (only what is due, of all views
  at once by :mod:`tables`), :mod:`alone` (a view of itself, only what has changed),
  :mod:`followed` (the same, made better by another picture of it).
"""

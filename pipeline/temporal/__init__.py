"""What one frame of a stream tells of the next: pictures in, decisions and means out.

Not in the thesis, which computes every frame on its own. Nothing here registers or solves;
:mod:`pipeline.superresolve.chain` asks in which order.

* :mod:`still`, :mod:`still_kernels`: what stands still, averaged over time;
* :mod:`initial`: blocks found again in the frame before, and its result moved along with them;
* :mod:`flow`: small patches found again to a fraction of a pixel, for what moves;
* :mod:`moving`: a moving camera told from a cut;
* :mod:`drift`, :mod:`lagging`: what changes little by little, all over or in parts;
* :mod:`alike`: what changes in several views alike;
* :mod:`neighbours`: pixels of the frames before and after as constraints (``--temporal-window``).
"""

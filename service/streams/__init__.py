"""Live streams: cameras in over the bus, super-resolved pictures out over it.

* in the service: :mod:`streams`, each a :mod:`stream` with its :mod:`states` and :mod:`options`,
  worked on by a :mod:`process`; what that said last is :mod:`numbers`;
* in that process: :mod:`worker` runs a :mod:`session`: first a :mod:`rehearsal`; :mod:`intake`,
  where :mod:`assembly` makes whole frames of parts; :mod:`outlets`, whose messages
  :mod:`sequences` numbers, and which makes :mod:`stills` for who asks; :mod:`latency`;
* :mod:`messages`: the JSON that goes along with pictures; :mod:`door`: the socket between the two;
* sources: :mod:`feed`, used by the :mod:`player` of a scene and the :mod:`relay` of cameras; on the
  other side :mod:`receiver`.
"""

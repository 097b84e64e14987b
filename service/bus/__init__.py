"""The way in and out for streams: key expressions, one protocol, zenoh behind it.

* :mod:`bus`: what streams need of a bus; :mod:`zenoh_bus` is zenoh, :mod:`memory` its twin within
  one process, for tests;
* :mod:`keys`: every key expression; :mod:`rules`: who may publish and watch, as zenoh's access
  control; :mod:`config`: how the bus is reached.
"""

"""What a job of the service is.

* :mod:`states`: its life, as a state machine; :mod:`request`: what a client asks for, without the
  fields of :mod:`paths`, which are not the client's to choose;
* :mod:`sinks`: where its frames go; :mod:`watch_sink`: what people watch while it runs;
* :mod:`pictures`: how large a picture says it is.
"""

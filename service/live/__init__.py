"""Watching while it is made: fragments stored once, handed to every viewer.

* :mod:`track`: a video in pieces on the disk; :mod:`fragments` cuts the encoder's bytes into them;
* :mod:`broadcast`: one video on its way to many viewers; :mod:`job_watch`: pieces of jobs;
* :mod:`hls`: playlists of what is stored.
"""

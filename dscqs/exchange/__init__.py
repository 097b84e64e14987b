"""Votes in the formats of others; nothing of a file is executed.

* :mod:`files`: a file of any known format read, and text of one written: tidy CSV or
* :mod:`sujson`, :mod:`sureal`: JSON, checked step by step by :mod:`plain`.
"""

"""The HTTP doors of the service: one module a resource.

* before all of them: :mod:`guards` (limits, origins, headers, access log), :mod:`auth` (tokens and
  scopes), :mod:`session` (a cookie for browsers); :mod:`problems`: errors as clients meet them;
* jobs: :mod:`submissions` with :mod:`uploads` and :mod:`quota`; :mod:`jobs` and :mod:`job_events`,
  seen as :mod:`job_views`; :mod:`results`, :mod:`exports`, :mod:`archive`;
* :mod:`streams`; :mod:`watch` for both; :mod:`pages`; :mod:`health` and :mod:`status`;
* subjective tests: :mod:`dscqs` for assessors; for operators :mod:`dscqs_access`,
  :mod:`dscqs_making` (with :mod:`dscqs_folders`), :mod:`dscqs_operator`; :mod:`dscqs_pages`,
  :mod:`dscqs_examples`;
* :mod:`files`: ranges, heads and tags, for all that send files.
"""

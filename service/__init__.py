"""The doors of the program: the ``depthsr`` command, jobs over HTTP, streams over zenoh, pages.

It knows :mod:`pipeline` and :mod:`dscqs`; neither knows it.

* the command: :mod:`cli`; its subcommands :mod:`cli_evaluate`, :mod:`cli_serve`,
  :mod:`cli_streams`, :mod:`cli_dscqs` with :mod:`cli_dscqs_tests` and :mod:`cli_simulate`; all with
  :mod:`options`, :mod:`terminal`, :mod:`console`, :mod:`progress`;
* the service: :mod:`app`, run by :mod:`server` with the settings of :mod:`config`; its doors are
  :mod:`service.http`; problems are :mod:`problem_table`;
* jobs: :mod:`service.jobs`, kept by :mod:`store`, given by :mod:`scheduler` to processes of
  :mod:`worker_process` (:mod:`child`), told by :mod:`notices`;
* streams: :mod:`service.streams` over :mod:`service.bus`;
* watching: :mod:`service.live` and :mod:`service.pages`;
* subjective tests: :mod:`desks`, :mod:`stimuli`, :mod:`plan_files`, :mod:`simulate`;
* from outside: :mod:`client`, :mod:`dscqs_client`; for operators: :mod:`metrics`,
  :mod:`json_logs`.
"""

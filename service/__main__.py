"""``python -m service``: the ``depthsr`` command."""

import sys

from service.cli import main

sys.exit(main())

"""``python -m potmesil_mi``: the command line."""

import sys

from .cli import main

sys.exit(main())

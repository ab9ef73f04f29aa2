"""``python -m crowdbench.cli``."""

import sys

from crowdbench.cli.app import main

sys.exit(main())

"""`python -m cloudtomo_cl` is `cloudtomo`."""

import sys

from cloudtomo_cl.commands.cli import main

sys.exit(main())

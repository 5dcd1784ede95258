"""`python -m cloudtomo_cl` is `cloudtomo`."""

import sys

from cloudtomo_cl.cli import main

sys.exit(main())

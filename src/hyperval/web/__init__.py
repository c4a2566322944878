"""The web application: pages and a JSON API over the verbs of the package, served to browsers on this machine.

Needs the extra ``web``.  The pages hold no formula and draw nothing themselves: forms follow from the schemas,
charts and tables from the reports.
"""

import lazy_loader

# What is not asked for is not loaded: names and modules stand in the file of types beside this one.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

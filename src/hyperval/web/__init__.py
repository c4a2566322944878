"""The web application: pages and a JSON API over the verbs of the package, served to browsers on this machine.

Needs the extra ``web``.  The pages hold no formula and draw nothing themselves: forms follow from the schemas,
charts and tables from the reports.
"""

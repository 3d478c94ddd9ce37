"""The page on which images are compared: one file that opens offline, in any browser of the last years, by itself.

:func:`write_report` makes it from images, :func:`report_comparison` from the folder of a comparison. On the page one
flips between images, splits them, zooms into both eyes at once, reads linear radiance, looks at error maps and at the
foveation's layers, and changes the exposure, which is applied to the linear data anew. The tables sort, and copy as CSV
or LaTeX. The file holds everything and asks for nothing else: its content security policy forbids any request.

How images are stored says :mod:`fovden.report.coding`.
"""

from fovden.report.comparison import report_comparison
from fovden.report.page import write_report
from fovden.report.tables import Column, Table, quality_tables

__all__ = ["Column", "Table", "quality_tables", "report_comparison", "write_report"]

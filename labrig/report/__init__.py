"""report: figures, pages and the rerun view of what others computed; computes nothing.

`write_report` makes `RUN/report.html` from a run and its result: one file that needs no network, prints on
A4 and opens in thirty years. The rerun view is made by `labrig.report.rerun_view`, which only `cli`
imports, and by that name: the viewer's library takes half a second to load, and a report needs none of it.

What is decided here:

- **Nothing is measured and nothing is averaged.** Numbers come from `result.json`, lines from its
  `centre_lines.npz`. The plane map is asked only where to draw: the fitted circle, the axes and the scale
  bar in the camera's view.
- **Pictures are JPEG, what is drawn on them is SVG**, so that lines stay sharp on paper and the picture
  stays whole.
- **Every run gets a page**, also an aborted one and one without a result: it says what is missing.
- **Whatever a person wrote is text.** jinja2 escapes everything; only figures that labrig drew are passed
  as they are.
- **Refusals stand beside results**: every picture that was not measured is listed with its reason.
- Colours are those of Okabe and Ito (2008), told apart by people with any colour vision; gels differ in
  marker too.
"""

from labrig.report.tables import run_tables

__all__ = ["run_tables"]

"""report: figures, pages and the rerun view of results; computes nothing.

`page.write_report` makes `RUN/report.html` from a run and its result: one file that needs no network, prints on A4 and
opens in thirty years. `rerun_view` draws a record for the rerun viewer, saved or while the run is made. Only `cli` and
`library` import that: the viewer's library takes half a second to load, and a report does not need it.

What is decided here:

- **Nothing is measured.** Numbers come from `result.json`, lines from its `centre_lines.npz`; the only averages are the
  medians of error budgets. The plane map only tells where to draw: the fitted circle, the axes and the scale bar.
- **Layout and words stand in templates.** Python hands over runs, results and plain values; what every page has is in
  `templates/base.html.jinja`, and the sentence of an event is a template of its kind (`event_words`).
- **Pictures are JPEG and the drawings on them are SVG**, so that lines stay sharp on paper and pictures stay intact.
- **Every run gets a page**, even an aborted run or one without a result; the page states what is missing.
- **Text that a person wrote stays text.** jinja2 escapes everything; only figures drawn by labrig are passed through.
- **A live view reads the record.** A process of its own follows the lines on disk and draws them with the functions
  that make `view.rrd`. Nothing is handed over by the process that moves axes, so no viewer can delay it.
- **What is served is served on this computer alone** (`local_server`); a page that asks (`picture_page`) under a token.
  Text reaches it as JSON and is written as text; the files of `browser` are fixed.
- **Refusals appear beside results**: every picture that was not measured is listed with the reason.
- Colours are those of Okabe and Ito (2008), which people with any colour vision tell apart; gels also differ in marker.
"""

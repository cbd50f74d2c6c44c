"""cli: parse, choose the rig, call, print; alone prints, prompts and exits.

Standard output carries results, standard error carries talk: progress, prompts, errors and their hints. With `--json`
standard output holds one JSON document and nothing else. Imports of the rooms below stand inside the commands, so that
`labrig --help` starts none of numpy, OpenCV, pandas or rerun.
"""

"""cli: parses the command line, finds the rig, calls the rooms below; only this room prints, prompts and exits.

Standard output carries results, standard error carries progress, prompts, errors and hints. With `--json`, standard
output holds one JSON document and nothing else. The rooms below are imported inside the commands, so that
`labrig --help` loads none of numpy, OpenCV, pandas or rerun.
"""

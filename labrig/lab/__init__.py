"""lab: the folder of a lab, with its protocols, rig files, calibration and runs, and the examples that it starts with.

Decided here:

- A lab folder is found upwards from the working folder, as git finds a repository, so that a command does the same in
  each of its subfolders. `labrig init` marks it with the file `.labrig`. A folder without that file is one too if it
  has the schemas of protocols and of rig files where labrig keeps them, as labrig's own checkout has.
- Runs go, in this order, to `--runs-dir`, `LABRIG_RUNS_DIR`, `data/runs` of the lab folder, `data/runs` below the
  working folder. `choose_runs_dir` alone decides that.
- A wheel holds the examples in `labrig/lab/files`. In a checkout they stand at its top level, once, and
  `pyproject.toml` says which they are. (Installing a checkout in place copies them too; nothing reads that copy.)
- The marker file keeps the SHA-256 of each example as labrig wrote it. By that, an update replaces the files that
  nobody has changed, and leaves all others alone.
"""

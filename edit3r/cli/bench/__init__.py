"""`edit3r bench`: the editing benchmark, one file a step."""

HELP = "the editing benchmark: build it, run methods on it, report"

"""This thesis' own code: claims and verdicts, experiments, figures, and the runner."""

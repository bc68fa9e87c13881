"""One HTML page of what a folder holds: a campaign, a run, or the figures and tables of a study."""

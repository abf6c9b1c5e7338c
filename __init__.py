"""Plan, render, and annotate synthetic detection datasets of vehicles on terrain."""

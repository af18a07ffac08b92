"""The stages of the pipeline, each with its cache."""

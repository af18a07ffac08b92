"""The robust estimator of pairs and cycles."""

"""Pictures of scans and of the model, as the report shows them."""

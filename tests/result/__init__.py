"""Results: their types, their JSON, their words."""

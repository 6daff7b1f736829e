"""Make floor plans that let robot fleets flow."""

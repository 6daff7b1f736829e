"""The domains: the only place that knows a domain's name and its own numbers."""

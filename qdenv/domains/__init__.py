"""The domains: rules, measures and numbers of each."""

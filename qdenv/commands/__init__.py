"""The commands of `qdenv`, by subject: parse, call, print."""

"""Operations: each is one typed function, which is `qdenv.NAME` in Python and a command as well."""

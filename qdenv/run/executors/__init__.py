"""Who repairs and simulates the layouts of a search: threads of this process, or a Dask cluster."""

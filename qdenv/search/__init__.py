"""The search: archives, evolution strategies and quality-diversity algorithms.

    axes                 measures to cells
    archive              the elitist grid archive (a qdax repertoire)
    insertion            what an archive says of a batch
    threshold_archive    the soft archive of CMA-MAE
    store                the solutions of several archives, each once
    strategies/          evolution strategies behind one face, ours and evosax'
    emitters             strategies that rank by an archive's verdict and restart from its elites
    base                 `Algorithm`: init, ask, tell
    growth               searches run from the host: compiled, their stores grow
    cma_mae, map_elites, cma_es, random_search    the algorithms that search numbers
    dsage/               the one that searches tiles, on a surrogate
    screening            CMA-MAE whose offspring a surrogate screens
    observed             what a surrogate learns from
    registry             algorithms by name
    qdax_emitter         CMA-MAE for qdax' own driver
    export               archives as tables and files

Nothing here knows what a layout is.
"""

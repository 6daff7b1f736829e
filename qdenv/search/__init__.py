"""The search: archives, evolution strategies and quality-diversity algorithms.

axes            measures to cells
archive         the grid archive, elitist or soft (a qdax repertoire)
base            `Algorithm`: init, ask, tell; the archives of a search; compiled for the host
strategies/     evolution strategies: evosax algorithms, ours and evosax' own
cma_mae         CMA-MAE, CMA-ME, CMA-ES: emitters, strategies that an archive ranks
map_elites      MAP-Elites, random search
rearrange       an evolution strategy that moves parts of a plan
model           the surrogate of a search
dsage           the search of tiles on a surrogate
screening       CMA-MAE whose offspring a surrogate screens
settings        what a user may choose
registry        algorithms by name
qdax_emitter    CMA-MAE for qdax' own driver
"""

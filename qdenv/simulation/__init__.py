"""Simulate: fleets of robots that find their paths for ever, and the single agent of the maze.

The movement rules of the fleets
================================

Each drawing below is run by the tests: letters are agents, ``#`` obstacles, ``.`` free cells, and
the pictures of a row follow one another in time.

**Cells and moves.** A cell is ``row * width + column``. In one timestep an agent moves to a free
cell above, below, left or right of it, or waits; both take one timestep.

    allowed: a move and a wait
    a..  .a.
    .#b  .#b

    forbidden: more than one step
    a..  ..a

    forbidden: an obstacle
    a#.  .a.

**Conflicts.** Two agents are never on one cell at the same time, and never swap cells.

    forbidden: agents on cell
    a.b  .a.

    forbidden: swap
    ab.  ba.

**Following and cycles.** An agent may enter the cell that another one leaves in the same timestep,
also all around a cycle.

    allowed: following
    ab.  .ab

    allowed: a cycle of four
    ab  da
    dc  cb

**Starts.** Agents start on distinct free cells, drawn at random for every seed.

**Goals.** Each agent visits the kinds of goal of its `TaskRule` in turn, again and again, beginning
with the first; which cell of a kind is drawn at random with the odds of the rule. Goals are not
reserved: agents may share one, and drive across those of others. Being on the goal after a step
finishes the task, so an agent may drive on at once; standing on a new goal already, it needs one
more step there. Here cells 1 and 2 are the goals of a, in turn.

    tasks: stay 0 on 1..2, finished at 1 4
    .a..  a...  .a..  ..a.  ...a

**Service.** Where a goal has a stay (its service time), the agent remains on it for that many
timesteps after arriving, and blocks the cell; then the task is finished. Nothing cuts a stay short.
Planners know two goals of each agent. An agent that comes upon a third one with a stay before
all are planned again drives on, and arrives there after the next planning.

    tasks: stay 2 on 1..2, finished at 3 8
    .a..  a...  a...  a...  .a..  ..a.  ...a  ...a  ...a

**Orders.** Where tasks arrive at a rate, an order is a task of each kind in turn. How many arrive
in a timestep is drawn (Poisson). Agents begin without one, where they stand. One that finishes an
order begins the next that waits, else drives towards the goal that it would have had, waits near
it, and gives way. Orders that wait are handed out by lot when all are planned again, with new
goals.

**Throughput** is the number of finished tasks (one leg each) divided by the timesteps T of
the run, also where it ended early.

**Jams.** All agents are planned again every h = 5 timesteps (the horizon). After each such window
an agent is stuck if its cell was the same at the window's first five timesteps (the last move is
not looked at), it was not serving and had an order. If more than half of the agents are stuck, the
run is congested and ends, or goes on where that is configured.

    jam: two of three agents are stuck
    ab.c  ab.c  abc.  ab.c  ab.c  .abc

    no jam: one of three agents is stuck
    ab.c  ab.c  abc.  a.bc  a.bc  ab.c
"""

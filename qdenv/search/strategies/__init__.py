"""Evolution strategies behind one face.

    base              `Strategy`: init, ask, tell; the update rules they share
    rates             weights and learning rates, as tables over the number of parents
    full              CMA-ES, Hansen 2016
    separable         sep-CMA-ES, Ros and Hansen 2008
    limited_memory    LM-MA-ES, Loshchilov, Glasmachers and Beyer 2017
    isotropic         CMA-ES before its first eigendecomposition
    evosax            strategies of the evosax library
    registry          strategies by name

Numbers in brackets, like (43), are equations of Hansen's tutorial,
https://arxiv.org/abs/1604.00772v1. Where pyribs departs from it, ours does as pyribs and says so.
"""

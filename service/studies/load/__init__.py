"""An hour of load on a real server with real workers, and what grew meanwhile.

Requests come at random moments of a fixed rate (a Poisson process of a seed), whether or not those
before them have been answered, and a latency counts from the moment at which the request was due:
a server that stands still for a second delays all that were due in it, and all of them tell.

    demand   what is asked, and when: a function of the seed
    crowd    threads that ask it
    watch    memory of each process, backlog, size of the database, while it runs
    trend    windows, percentiles, and whether something grows (Theil-Sen)
    aims     what it is held against
    run      all of it together
    backlog  one that is worked off by one worker, and one by two
"""

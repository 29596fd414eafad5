"""Studies that disturb a running service and then ask its tables what became of every reading.

The claim: a reading that was acknowledged is in the log for ever, every version of a posterior
rests on exactly the entries up to where it ends, each once, and the sealed end is bit for bit that
of a service that nobody disturbed.

    traffic     what is posted, from a seed: readings, corrections, retractions, repetitions
    clients     posting, side by side, again and again until it is acknowledged
    processes   the API and its workers as processes of their own, to be killed
    check       the tables against what was acknowledged
    chaos       all of it together, and the same traffic undisturbed
"""

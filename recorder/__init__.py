"""The shop-floor edge: Zenoh in, one MCAP file per demonstration out.

daemon      the recorder of a cell, put together
recovery    recordings that were found unfinished     teaching    what the teacher is told meanwhile
salvage, replay, imports, intake, upload              from files, to files, from the network, to the service
recording   the format: writer, reader, MCAP's bytes
foxglove    what a recording shows of itself to those who look at it
clocks, wire, disk, notices, durable, errors, paths   what all of them use

Calls go down.
"""

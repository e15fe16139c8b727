"""One file a network. Each imports the network's own library when it is loaded, takes weights from a path, and never
downloads anything. ``load(path, options)`` gives a service; its class takes the network itself, so that another of the
same interface can stand in for it.
"""

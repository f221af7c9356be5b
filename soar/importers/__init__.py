"""Readers of body parameters that other tools wrote, one module each, and a network that estimates them.

A reader opens files and undoes a tool's conventions; what the parameters are for is not its business.
"""

"""Faults planted on purpose: do the checks of the ledger notice them?"""

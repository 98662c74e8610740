"""Faults planted on purpose: do the tests, the checks and an interrupted run notice them?"""

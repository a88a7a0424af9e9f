"""The sub-commands of ``fbn``: options and words here, the work in the packages, imported when it is called for."""

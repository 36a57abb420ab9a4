"""Configuration: parameters, parameter files, files of extended models, as checked joints."""

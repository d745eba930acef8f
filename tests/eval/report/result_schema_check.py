#!/usr/bin/env python3
"""Validates files against a JSON Schema: result_schema_check.py SCHEMA FILE... Exit code 1 and the places of what is
wrong where a file is not valid. Needs the package jsonschema."""

import json
import sys

import jsonschema


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        schema = json.load(file)
    jsonschema.Draft7Validator.check_schema(schema)
    validator = jsonschema.Draft7Validator(schema)
    wrong = 0
    for path in sys.argv[2:]:
        with open(path, encoding="utf-8") as file:
            for error in validator.iter_errors(json.load(file)):
                wrong += 1
                print(f"{path}: {'.'.join(str(part) for part in error.absolute_path)}: {error.message[:200]}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

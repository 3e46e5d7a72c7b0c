"""MLCommons Croissant 1.0 metadata of a split: its public files, never a region.

Source: the specification at docs.mlcommons.org/croissant; `mlcroissant` validates it in the tests.
"""

import hashlib
from collections.abc import Mapping

from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.datasheet import Datasheet

_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


def croissant(sheet: Datasheet, files: Mapping[str, bytes]) -> bytes:
    """Describe the public files of a split, given by name; `manifest.json` is among them."""
    words = sheet.words
    document = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": sheet.name,
        "description": words.purpose or sheet.title,
        "version": f"1.0.0+{sheet.revision.removeprefix('sha256:')[:12]}",
        "license": words.licence_url or words.licence or None,
        "url": words.url or None,
        "datePublished": words.published or None,
        "citeAs": f"{sheet.title}, revision {sheet.revision}",
        "distribution": [_file(name, content) for name, content in files.items()],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "samples",
                "name": "samples",
                "description": "Every sample that a file of trajectories answers.",
                "field": [
                    {
                        "@type": "cr:Field",
                        "@id": "samples/sample_id",
                        "name": "sample_id",
                        "description": "Key of the sample.",
                        "dataType": "sc:Text",
                        "source": {
                            "fileObject": {"@id": "manifest.json"},
                            "extract": {"jsonPath": "$.sample_ids[*]"},
                        },
                    }
                ],
            }
        ],
    }
    return canonical_json({key: value for key, value in document.items() if value is not None})


def _file(name: str, content: bytes) -> dict[str, str]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{len(content)} B",
        "encodingFormat": "application/json",
        "sha256": hashlib.sha256(content).hexdigest(),
    }

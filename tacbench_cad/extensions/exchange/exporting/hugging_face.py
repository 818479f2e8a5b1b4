"""``huggingface``: Parquet files with the images, a dataset card and Croissant metadata, for ``datasets``."""

from __future__ import annotations

import contextlib
import json
from datetime import datetime
from pathlib import Path
from typing import Any

from tacbench_cad.extensions.exchange.exporting.card import summary
from tacbench_cad.extensions.exchange.exporting.columns import COLUMNS
from tacbench_cad.extensions.exchange.exporting.export_formats import ExportFormat
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples
from tacbench_cad.util.files import write_json

#: The sizes of a file and of a group of rows in bytes of images, and the largest number of rows of a group. Only one
#: group is in memory at a time.
SHARD_BYTES, GROUP_BYTES, GROUP_ROWS = 500_000_000, 16_000_000, 1000
#: The folder of the Parquet files, and the file of the metadata.
FOLDER, CROISSANT_FILE = "data", "croissant.json"
#: The column of the images. Each value has the bytes and the name of the image.
IMAGE = "image"
LOADING = (
    'from datasets import load_dataset\n\ndataset = load_dataset(".", split="train")\n'
    'dataset[0]["image"], dataset[0]["label"]'
)
#: The names of the column types in Arrow (and ``datasets``), and in schema.org.
ARROW = {str: "string", int: "int64", float: "float64", bool: "bool", datetime: "timestamp[ms, tz=UTC]"}
SCHEMA_ORG = {str: "sc:Text", int: "sc:Integer", float: "sc:Float", bool: "sc:Boolean", datetime: "sc:DateTime"}


def write(samples: Samples, folder: Path, shard_bytes: int = SHARD_BYTES) -> None:
    """Write the files and the metadata. The bytes of the images are not changed."""
    samples.require_images("huggingface")
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema(pa, samples)
    (folder / FOLDER).mkdir()
    writer: Any = None
    rows: list[dict[str, Any]] = []
    written = waiting = number = 0
    with contextlib.ExitStack() as shards:
        for count, sample in enumerate(samples, start=1):
            if writer is None:
                path = folder / FOLDER / f"train-{number:05d}.parquet"
                writer, written, number = shards.enter_context(pq.ParquetWriter(path, schema)), 0, number + 1
            rows.append({IMAGE: {"bytes": sample.data, "path": sample.key + sample.suffix}, **sample.values})
            waiting += len(sample.data)
            full = written + waiting >= shard_bytes or count == len(samples)
            if full or waiting >= GROUP_BYTES or len(rows) == GROUP_ROWS:
                writer.write_table(pa.Table.from_pylist(rows, schema=schema))
                written, waiting = written + waiting, 0
                rows.clear()
            if full:
                shards.close()
                writer = None
    write_json(folder / CROISSANT_FILE, croissant(samples))


def card_head(samples: Samples) -> str:
    """Return the YAML header of a dataset card. Strings are written as JSON, which is also valid YAML."""
    size = next((text for limit, text in _SIZES if len(samples) < limit), "n>1M")
    tags = ["tactile", "robotics", "tacbench-cad", *(["simulated"] if samples.simulated else [])]
    return "\n".join(
        [
            "---",
            'pretty_name: "Tactile frames"',
            f"tags: {json.dumps(tags)}",
            'task_categories: ["image-classification"]',
            f"size_categories: [{json.dumps(size)}]",
            "configs:",
            "- config_name: default",
            "  data_files:",
            "  - split: train",
            f"    path: {FOLDER}/train-*.parquet",
            "---",
            "",
        ]
    )


_SIZES = ((1000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def _schema(pa: Any, samples: Samples) -> Any:
    fields = [pa.field(IMAGE, pa.struct([("bytes", pa.binary()), ("path", pa.string())]))]
    features: dict[str, dict[str, str]] = {IMAGE: {"_type": "Image"}}
    for column in COLUMNS:
        kind = pa.timestamp("ms", tz="UTC") if column.kind is datetime else pa.type_for_alias(ARROW[column.kind])
        fields.append(pa.field(column.name, kind, metadata={"description": column.description}))
        features[column.name] = {"_type": "Value", "dtype": ARROW[column.kind]}
    about = {
        "huggingface": json.dumps({"info": {"features": features}}),
        "description": summary(samples),
        "simulated": "; ".join(samples.simulated),
    }
    return pa.schema(fields, metadata=about)


def croissant(samples: Samples) -> dict[str, Any]:
    """Return the Croissant metadata, which describe the files and the columns."""
    described = [
        (IMAGE, "sc:ImageObject", "The frame.", {"extract": {"column": IMAGE}, "transform": {"jsonPath": "bytes"}})
    ]
    described += [
        (column.name, SCHEMA_ORG[column.kind], column.description, {"extract": {"column": column.name}})
        for column in COLUMNS
    ]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": "tactile-frames",
        "description": summary(samples),
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "keywords": ["tactile", *(["simulated"] if samples.simulated else [])],
        "distribution": [
            {
                "@type": "cr:FileSet",
                "@id": "parquet-files",
                "name": "parquet-files",
                "encodingFormat": "application/x-parquet",
                "includes": f"{FOLDER}/*.parquet",
            }
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "frames",
                "name": "frames",
                "field": [
                    {
                        "@type": "cr:Field",
                        "@id": f"frames/{name}",
                        "name": f"frames/{name}",
                        "description": description,
                        "dataType": kind,
                        "source": {"fileSet": {"@id": "parquet-files"}, **source},
                    }
                    for name, kind, description, source in described
                ],
            }
        ],
    }


#: The context that Croissant 1.0 prescribes.
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    **{
        name: f"cr:{name}"
        for name in (
            *("citeAs", "column", "extract", "field", "fileProperty", "fileObject", "fileSet", "format", "includes"),
            *("isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex"),
            *("repeated", "replace", "separator", "source", "subField", "transform"),
        )
    },
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
}


FORMAT = ExportFormat(write=write, loading=LOADING, modules=("pyarrow",), head=card_head)

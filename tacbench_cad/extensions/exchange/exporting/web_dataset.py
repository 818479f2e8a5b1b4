"""``webdataset``: tar files with an image (or a NumPy file) and a JSON document for each frame."""

from __future__ import annotations

import contextlib
import io
import json
import tarfile
from pathlib import Path

from tacbench_cad.extensions.exchange.exporting.card import summary
from tacbench_cad.extensions.exchange.exporting.columns import json_values
from tacbench_cad.extensions.exchange.exporting.export_formats import ExportFormat
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples

#: The size at which a new tar file is started, in bytes.
SHARD_BYTES = 500_000_000
LOADING = (
    'import glob\n\nimport webdataset\n\nfiles = sorted(glob.glob("frames-*.tar"))\n'
    "frames = webdataset.WebDataset(files, shardshuffle=False)\n"
    'for frame, values in frames.decode("pil").to_tuple("png;jpg;npy", "json"):\n'
    '    frame, values["label"]'
)


def write(samples: Samples, folder: Path, shard_bytes: int = SHARD_BYTES) -> None:
    """Write the tar files. The header of each file describes the data, and says whether they are simulated."""
    shard: tarfile.TarFile | None = None
    number = 0
    with contextlib.ExitStack() as shards:
        for sample in samples:
            if shard is None or shard.offset >= shard_bytes:
                shards.close()
                path, about = folder / f"frames-{number:06d}.tar", {"comment": summary(samples)}
                shard = shards.enter_context(tarfile.open(path, "w", format=tarfile.PAX_FORMAT, pax_headers=about))
                number += 1
            document = json.dumps(json_values(sample.values), allow_nan=False).encode()
            for suffix, data in ((sample.suffix, sample.data), (".json", document)):
                member = tarfile.TarInfo(sample.key + suffix)
                member.size = len(data)
                shard.addfile(member, io.BytesIO(data))
            shard.members.clear()  # type: ignore[attr-defined] # otherwise the list of members would grow without end


FORMAT = ExportFormat(write=write, loading=LOADING)

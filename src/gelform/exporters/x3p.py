"""X3P, the XML container of surface topography (ISO 25178-72, openGPS): heights in metres, with checksums.

A zip of `main.xml`, `bindata/data.bin` (little-endian heights, row by row from the least y) and `md5checksum.hex`. The axes
are x right, y up, z towards the camera, right-handed: the image's rows are stored from the last to the first, and z is
depth. Heights that are not known are NaN, as the format says it.
"""

from __future__ import annotations

import hashlib
import io
import zipfile

import numpy as np

from gelform.reconstruction import Reconstruction

NAMESPACE = "http://www.opengps.eu/2008/ISO5436_2"
DATA, CHECKSUM = "bindata/data.bin", "md5checksum.hex"
M_PER_MM = 1e-3
_MAIN = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="{namespace}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:schemaLocation="{namespace} {namespace}/ISO5436_2.xsd">
  <Record1>
    <Revision>ISO5436 - 2000</Revision>
    <FeatureType>SUR</FeatureType>
    <Axes>
      <CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{x!r}</Increment><Offset>0.0</Offset></CX>
      <CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{y!r}</Increment><Offset>0.0</Offset></CY>
      <CZ><AxisType>A</AxisType><DataType>D</DataType><Increment>1.0</Increment><Offset>0.0</Offset></CZ>
    </Axes>
  </Record1>
  <Record3>
    <MatrixDimension><SizeX>{width}</SizeX><SizeY>{height}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
    <DataLink><PointDataLink>{data}</PointDataLink><MD5ChecksumPointData>{md5}</MD5ChecksumPointData></DataLink>
  </Record3>
  <Record4><ChecksumFile>{checksum}</ChecksumFile></Record4>
</p:ISO5436_2>
"""


def x3p_bytes(result: Reconstruction) -> bytes:
    """The container of a result with mm_per_px; the same bytes for the same result."""
    height, width = result.depth_mm.shape
    heights = np.where(result.known, result.depth_mm.astype(np.float64) * M_PER_MM, np.nan)
    data = heights[::-1].astype("<f8").tobytes()
    pitch = np.broadcast_to(np.asarray(result.mm_per_px, dtype=np.float64), 2) * M_PER_MM
    main = _MAIN.format(
        namespace=NAMESPACE,
        x=float(pitch[0]),
        y=float(pitch[1]),
        width=width,
        height=height,
        data=DATA,
        md5=_md5(data),
        checksum=CHECKSUM,
    ).encode()
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as file:
        for name, member in (
            ("main.xml", main),
            (DATA, data),
            (CHECKSUM, f"{_md5(main)} *main.xml\n".encode()),
        ):
            file.writestr(zipfile.ZipInfo(name), member, zipfile.ZIP_DEFLATED)
    return content.getvalue()


def _md5(content: bytes) -> str:
    """As the format asks for; nothing is kept secret by it."""
    return hashlib.md5(content, usedforsecurity=False).hexdigest()

"""A tree of files as Linux shows cameras in: sys/class/video4linux, the USB devices, dev/v4l/by-path."""


def plug_in(root, number, product, usb_id=None, serial=None, socket="1-2", nodes=2):
    """Add a camera with its metadata node; its nodes are videoN and those after it."""
    classes, by_path = root / "sys/class/video4linux", root / "dev/v4l/by-path"
    for folder in (classes, by_path):
        folder.mkdir(parents=True, exist_ok=True)
    device = root / "sys/devices/pci0000:00/0000:00:14.0/usb1" / socket
    interface = device / f"{socket}:1.0"
    interface.mkdir(parents=True)
    if usb_id is not None:
        vendor, model = usb_id.split(":")
        told = {"idVendor": vendor, "idProduct": model, "product": product, "serial": serial}
        for name, text in told.items():
            if text is not None:
                (device / name).write_text(text + "\n")
    for index in range(nodes):
        node = interface / "video4linux" / f"video{number + index}"
        node.mkdir(parents=True)
        (node / "name").write_text(f"{product}: {product}"[:31] + "\n")
        (node / "index").write_text(f"{index}\n")
        (node / "device").symlink_to("../..")
        (classes / node.name).symlink_to(node)
        (root / "dev" / node.name).write_text("")
        link = by_path / f"pci-0000:00:14.0-usb-0:{socket[2:]}:1.0-video-index{index}"
        link.symlink_to(f"../../{node.name}")
    return device


MINI, DIGIT = "0c45:636d", "2833:0209"

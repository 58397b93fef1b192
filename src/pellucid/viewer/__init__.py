"""The viewer: a page in the browser that shows frames of a `pellucid.realtime` engine and lets everything be changed."""

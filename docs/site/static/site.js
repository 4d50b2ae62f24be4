// What the pages need beside the theme: other versions, focus on what scrolls, the search from files.
'use strict';

document.addEventListener('DOMContentLoaded', () => {
    listVersions();
    focusScrollers();
    addEventListener('resize', focusScrollers);
});

// Browsers let a page that is a file read no other file, and the search would read each page that it found for an excerpt.
if (location.protocol === 'file:') DOCUMENTATION_OPTIONS.SHOW_SEARCH_SUMMARY = false;

// versions.js, beside the versions' folders, has the pages of each; a page that a version lacks leads to its first.
function listVersions() {
    const box = document.querySelector('.versions');
    if (!box || !window.gelformVersions) return;
    const { version, page, root } = box.dataset;
    for (const [name, pages] of Object.entries(window.gelformVersions)) {
        const link = document.createElement('a');
        link.href = `${root}${name}/${pages.includes(page) ? page : 'index'}.html`;
        link.textContent = name;
        if (name === version) link.setAttribute('aria-current', 'true');
        box.querySelector('ul').appendChild(document.createElement('li')).append(link);
    }
    box.hidden = false;
}

// Who has no mouse scrolls with the arrow keys, once the part has the focus.
function focusScrollers() {
    for (const part of document.querySelectorAll('article pre, .math, .table-wrapper')) {
        if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
        else part.removeAttribute('tabindex');
    }
}

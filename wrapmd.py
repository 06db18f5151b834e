"""Wrap prose paragraphs and list items at 100 columns; leave tables, code, headings."""
import sys,re,textwrap
for p in sys.argv[1:]:
    L=open(p).read().split("\n"); out=[]; i=0; code=False
    while i<len(L):
        s=L[i]
        if s.startswith("```"): code=not code; out.append(s); i+=1; continue
        if code or not s.strip() or s.startswith(("|","#","    ","<","![","[",">")) or s.startswith("\t"): out.append(s); i+=1; continue
        m=re.match(r"(\s*)([-*] |\d+\. )?",s); ind=m.group(1); mark=m.group(2) or ""
        para=[s[len(ind)+len(mark):]]; i+=1
        hang=ind+" "*len(mark)
        while i<len(L):
            n=L[i]
            if not n.strip() or n.startswith(("|","#","```","<","![",">")) or re.match(r"\s*([-*] |\d+\. )",n): break
            if mark and not n.startswith(hang) and not n.startswith(" "): 
                pass
            if not mark and n.startswith("    "): break
            para.append(n.strip()); i+=1
        text=" ".join(x.strip() for x in para)
        hard=[x for x in para[:-1] if x.endswith("  ")]
        w=textwrap.wrap(text,100,initial_indent=ind+mark,subsequent_indent=hang,break_long_words=False,break_on_hyphens=False)
        out+=w
    open(p,"w").write("\n".join(out))
